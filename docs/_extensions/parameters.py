"""The directive `parameters`: a table of a recipe's parameters, with presets and meaning."""

import json
from collections.abc import Iterator
from dataclasses import fields

from docutils import nodes
from docutils.statemachine import StringList
from numpydoc.docscrape import ClassDoc
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from geomesh.recipe import PRESETS, Recipe


class Parameters(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        found = nodes.Element()
        lines = StringList(list(table()), source="geomesh.recipe")
        self.state.nested_parse(lines, self.content_offset, found)
        return found.children


def table() -> Iterator[str]:
    widths = f"   :widths: 22 {'13 ' * len(PRESETS)} 52"
    yield from (".. list-table::", "   :header-rows: 1", "   :class: parameters", widths, "")
    yield from row("parameter", *PRESETS, "meaning")
    meanings = {
        name.strip(): " ".join(parameter.desc)
        for parameter in ClassDoc(Recipe)["Parameters"]
        for name in parameter.name.split(",")
    }
    for field in fields(Recipe):
        if field.name == "preset":
            continue
        values = (f"``{shown(getattr(recipe, field.name))}``" for recipe in PRESETS.values())
        yield from row(f"``{field.name}``", *values, meanings[field.name])


def row(*cells: str) -> Iterator[str]:
    for mark, cell in zip("*" + " " * len(cells), cells, strict=False):
        yield f"   {mark} - {cell}"


def shown(value: object) -> str:
    """Return a value as it is written in `--set NAME=VALUE`."""
    return value if isinstance(value, str) else json.dumps(value)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("parameters", Parameters)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
