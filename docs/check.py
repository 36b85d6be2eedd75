"""Check the built site: it needs no network, its links work, and it describes every command.

`make docs` runs it: ``python docs/check.py build/docs``.
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from geomesh.cli import cli

# Tags and attributes that make a browser load a file to show a page.
LOADED = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("iframe", "src"),
    ("source", "src"),
    ("video", "src"),
    ("object", "data"),
}


class Page(HTMLParser):
    """The anchors of a page, its links, and the files that it loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif (tag, name) in LOADED and value:
                self.loaded.append(value)
            elif (tag, name) == ("a", "href") and value:
                self.links.append(value)


def main(site: Path) -> int:
    pages = read(site)
    problems = [*outside(pages), *styles(site), *dangling(pages), *missing(pages, site)]
    for problem in problems:
        print(problem, file=sys.stderr)
    print(f"{len(pages)} pages, {len(problems)} problems")
    return 1 if problems else 0


def read(site: Path) -> dict[Path, Page]:
    # Skip `_static`: it contains templates of the theme.
    found = (path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts)
    return {path.resolve(): Page(path) for path in found}


def outside(pages: dict[Path, Page]) -> Iterator[str]:
    for path, page in pages.items():
        for target in page.loaded:
            if urlsplit(target).netloc:
                yield f"{path.name} loads {target} from the network"


def styles(site: Path) -> Iterator[str]:
    for path in site.rglob("*.css"):
        for target in re.findall(
            r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')]+)", path.read_text()
        ):
            yield f"{path.name} loads {target} from the network"


def dangling(pages: dict[Path, Page]) -> Iterator[str]:
    for path, page in pages.items():
        for link in page.links + page.loaded:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                yield f"{path.name} links to {link}, which does not exist"
            elif target in pages and unquote(parts.fragment) not in {"", *pages[target].anchors}:
                yield f"{path.name} links to {link}, but that page has no such anchor"


def missing(pages: dict[Path, Page], site: Path) -> Iterator[str]:
    reference = pages.get((site / "cli.html").resolve())
    for name in cli.commands:
        if reference is None or f"geomesh-{name}" not in reference.anchors:
            yield f"cli.html does not describe geomesh {name}"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
