"""The directive `commands`: describes every command with the text of its `--help`."""

import inspect
import textwrap

import click
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import nested_parse_with_titles

from geomesh.cli import cli


class Commands(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        lines = describe(cli, "geomesh", "")
        for name, command in cli.commands.items():
            lines += describe(command, f"geomesh {name}", f"geomesh {name}")
        found = nodes.section()
        found.document = self.state.document
        nested_parse_with_titles(self.state, StringList(lines, source="geomesh.cli"), found)
        return found.children


def describe(command: click.Command, path: str, title: str) -> list[str]:
    """Return a command in reStructuredText, as a separate section if it has a title."""
    context = click.Context(command, info_name=path)
    heading = [title, "-" * len(title), ""] if title else []
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    options = [param for param in command.params if isinstance(param, click.Option)]
    return [
        *heading,
        *block(usage),
        *prose(command.help or ""),
        f".. program:: {path}",
        "",
        *(line for option in options for line in describe_option(option, context)),
    ]


def prose(text: str) -> list[str]:
    r"""Return the paragraphs of a help text; a paragraph after \b becomes a code block."""
    lines = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if not paragraph.startswith("\b"):
            lines += [" ".join(paragraph.split("\n")), ""]
            continue
        _, title, *code = paragraph.split("\n")
        lines += [f".. rubric:: {title.rstrip(':')}", "", *block(textwrap.dedent("\n".join(code)))]
    return lines


def block(code: str) -> list[str]:
    return [".. code-block:: sh", "", *(f"   {line}" for line in code.splitlines()), ""]


def describe_option(option: click.Option, context: click.Context) -> list[str]:
    record = option.get_help_record(context)
    if record is None:
        return []
    names, text = record
    return [f".. option:: {names.replace(' / ', ', ')}", "", f"   {escape(text)}", ""]


def escape(text: str) -> str:
    return text.replace("*", r"\*").replace("|", r"\|")


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
