"""Check the source code for Qt 6 and old Pythons, which need not be installed.

Enumerations are the main problem: Qt 5 accepts `Qt.AlignLeft`, but Qt 6 requires
`Qt.AlignmentFlag.AlignLeft`. The check looks up each name in the classes of the QGIS that runs
the tests. So a rule applies to all classes of Qt and QGIS, and no list of classes is needed. The
names of Qt 6 come from the stubs of PyQt6. QAction moved from QtWidgets to QtGui in Qt 6. QGIS
offers it in qgis.PyQt.QtWidgets for both versions, but QGIS 3.22 does not offer it in QtGui.
"""

from __future__ import annotations

import ast
import enum
import functools
import importlib
import importlib.metadata
import inspect
import sys
from pathlib import Path

import pytest

PLUGIN = Path(__file__).parents[1] / "geomesh_qgis"
SOURCES = sorted(PLUGIN.rglob("*.py"))

# Modules that were added to the standard library in 3.11 or later. QGIS 3.22 has Python 3.9.
TOO_NEW = {"tomllib", "annotationlib", "compression"}

# Names that qgis.PyQt adds to PyQt6.
SHIM = {"QtWidgets": {"QAction", "QActionGroup", "QShortcut"}, "QtCore": {"NULL"}}

# Methods that Qt 6 or PyQt6 removed. The class of an object is not known here, so only the name
# is checked. The list contains only names that no other class uses.
# fmt: off
DROPPED = {
    "exec_", "print_", "desktop", "fromTime_t", "toTime_t", "widthChar", "setTabStopWidth",
    "tabStopWidth", "setCodec", "regExp", "filterRegExp", "setFilterRegExp", "indexIn",
    "lastIndexIn", "matchedLength", "exactMatch", "localPos", "windowPos", "screenPos",
    "hiResGlobalX", "hiResGlobalY", "screenNumber", "screenGeometry", "isVirtualDesktop",
    "codecForName", "canEncode", "fromUnicode", "toUnicode", "isRecursive", "setMargin",
    "hasPendingEvents",
}
# fmt: on

QT_MODULES = ("QtCore", "QtGui", "QtWidgets")


def is_enum_type(thing: object) -> bool:
    return inspect.isclass(thing) and issubclass(thing, (int, enum.Enum))


def is_member(value: object) -> bool:
    # The enumerations of sip are subclasses of int. Some of those of QGIS are IntEnums.
    return isinstance(value, enum.Enum) or (
        isinstance(value, int) and type(value) not in (int, bool)
    )


def members(thing: object) -> set[str]:
    """Return the enumeration members of a class that can be used without the enumeration."""
    if not inspect.isclass(thing) or is_enum_type(thing):
        return set()
    return {name for name in dir(thing) if is_member(getattr(thing, name, None))}


# ---- Qt 6, from its stubs


@functools.cache
def qt6(module: str) -> dict[str, tuple[set[str], list[str]]]:
    """Return the names and bases of each class of a PyQt6 module.

    Nested classes are called `Qt.AlignmentFlag`, for example. The name of the module itself is "".
    """
    path = importlib.metadata.distribution("PyQt6").locate_file(f"PyQt6/{module}.pyi")
    classes: dict[str, tuple[set[str], list[str]]] = {}

    def visit(owner: str, body: list[ast.stmt], bases: list[ast.expr]) -> None:
        names = set()
        for node in body:
            if isinstance(node, ast.ClassDef):
                visit(f"{owner}.{node.name}".lstrip("."), node.body, node.bases)
                names.add(node.name)
            elif isinstance(node, ast.FunctionDef):
                names.add(node.name)
            elif isinstance(node, ast.Assign):
                names.update(target.id for target in node.targets if isinstance(target, ast.Name))
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                names.add(node.target.id)
        classes[owner] = names, [ast.unparse(base).strip("'\"") for base in bases]

    visit("", ast.parse(Path(str(path)).read_text(encoding="utf-8")).body, [])
    return classes


def find_in_qt6(module: str, owner: str, name: str) -> tuple[str, str] | None:
    """Return the module and class of Qt 6 that define a name for a class, or for its bases."""
    names, bases = qt6(module).get(owner, (set(), []))
    if name in names or (not owner and name in SHIM.get(module, ())):
        return module, owner
    for base in bases:
        home, _, inherited = base.partition(".")
        if home not in QT_MODULES:
            home, inherited = module, base
        if found := find_in_qt6(home, inherited, name):
            return found
    return None


def in_qt6(module: str, names: list[str]) -> bool:
    """Return whether Qt 6 has a dotted name."""
    owner = ""
    for name in names:
        found = find_in_qt6(module, owner, name)
        if not found:
            # An enumeration also has the attributes of every Python enumeration, such as `value`.
            bases = qt6(module).get(owner, (set(), []))[1]
            return any(base.startswith("enum.") for base in bases) and hasattr(enum.IntFlag, name)
        module, owner = found[0], f"{found[1]}.{name}".lstrip(".")
    return True


# ---- the check of one source file


class Check(ast.NodeVisitor):
    def __init__(self, tree: ast.Module) -> None:
        self.findings: list[str] = []
        self._names: dict[str, tuple[object, str]] = {}  # local name -> object, its full name
        self._depth = 0  # number of nested functions
        self._guarded = 0  # inside `if hasattr(...)` or a similar condition
        self._own = {node.attr for node in ast.walk(tree) if _is_target(node, ast.Attribute)}
        self._own |= {node.id for node in ast.walk(tree) if _is_target(node, ast.Name)}
        self._relative: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                self._learn(node)
        self._members = {m for thing, _ in self._names.values() for m in members(thing)} - self._own
        self.visit(tree)

    def _say(self, node: ast.AST, text: str) -> None:
        self.findings.append(f"line {node.lineno}: {text}")

    def _learn(self, node: ast.Import | ast.ImportFrom) -> None:
        """Store the object for each name that is imported from qgis."""
        if isinstance(node, ast.ImportFrom):
            if node.level:
                self._relative.update(alias.asname or alias.name for alias in node.names)
            elif (node.module or "").split(".")[0] == "qgis":
                module = importlib.import_module(node.module)
                for alias in node.names:
                    full = f"{node.module}.{alias.name}"
                    thing = getattr(module, alias.name, None)
                    if thing is None:
                        try:
                            thing = importlib.import_module(full)
                        except ImportError:
                            self._say(node, f"{full} does not exist")
                    self._names[alias.asname or alias.name] = thing, full
                    self._look_up_in_qt6(node, full)
        else:
            for alias in node.names:
                if alias.name.split(".")[0] == "qgis":
                    module = importlib.import_module(alias.name)
                    top = module if alias.asname else sys.modules["qgis"]
                    self._names[alias.asname or "qgis"] = (
                        top,
                        alias.name if alias.asname else "qgis",
                    )

    def _look_up_in_qt6(self, node: ast.AST, full: str) -> bool:
        _, *parts = full.split(".")
        if parts[0] != "PyQt" or len(parts) < 3 or parts[1] not in QT_MODULES:
            return True
        if in_qt6(parts[1], parts[2:]):
            return True
        self._say(node, f"{'.'.join(parts[1:])} is not in Qt 6")
        return False

    # -- imports

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self._check_import(node, alias.name)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if not node.level:
            self._check_import(node, node.module or "")

    def _check_import(self, node: ast.AST, module: str) -> None:
        top = module.split(".", maxsplit=1)[0]
        if top.startswith(("PyQt", "PySide")) or top == "sip":
            self._say(node, f"import {module}: take it from qgis.PyQt")
        elif top == "geomesh":
            self._say(node, "import geomesh: the library runs in a process and a Python of its own")
        elif top in TOO_NEW:
            self._say(node, f"import {module}: Python 3.9 has no such module")
        elif not self._depth and top != "qgis" and top not in sys.stdlib_module_names:
            self._say(node, f"import {module} while QGIS starts: import it where it is used")

    # -- attributes

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._depth += 1
        self.generic_visit(node)
        self._depth -= 1

    def visit_If(self, node: ast.If | ast.IfExp) -> None:
        test = ast.unparse(node.test)
        guard = "hasattr" in test or "version" in test.lower()
        self._guarded += guard
        self.generic_visit(node)
        self._guarded -= guard

    visit_IfExp = visit_If

    def visit_Assign(self, node: ast.Assign) -> None:
        """Treat `kind = QgsThing.Kind` as another name of the same class."""
        root, attributes = _chain(node.value)
        if isinstance(root, ast.Name) and root.id in self._names:
            thing, full = self._names[root.id]
            for name in attributes:
                thing, full = getattr(thing, name, None), f"{full}.{name}"
            if inspect.isclass(thing):
                for target in node.targets:
                    if isinstance(target, ast.Name):
                        self._names[target.id] = thing, full
        self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        root, attributes = _chain(node)
        if isinstance(root, ast.Name) and root.id in self._names:
            self._follow(node, *self._names[root.id], attributes)
            return
        if attributes[-1] in DROPPED:
            self._say(node, f".{attributes[-1]} is not in Qt 6")
        own = isinstance(root, ast.Name) and root.id in self._relative
        if len(attributes) == 1 and attributes[0] in self._members and not own:
            self._say(node, f"{ast.unparse(node)}: name the enumeration")
        self.visit(root)

    def _follow(self, node: ast.AST, thing: object, full: str, attributes: list[str]) -> None:
        """Resolve a dotted name as Python does, as long as it is in modules and classes."""
        for name in attributes:
            if not (inspect.isclass(thing) or inspect.ismodule(thing)):
                return
            full = f"{full}.{name}"
            if not hasattr(thing, name):
                if not self._guarded:
                    self._say(node, f"{full} does not exist in this QGIS")
                return
            value = getattr(thing, name)
            if is_member(value) and not is_enum_type(thing):
                self._say(
                    node, f"{full} has to be {full[: -len(name)]}{type(value).__name__}.{name}"
                )
            elif not self._guarded and not self._look_up_in_qt6(node, full):
                return
            thing = value


def _is_target(node: ast.AST, kind: type) -> bool:
    """Return whether a node of that kind is the target of an assignment."""
    return isinstance(node, kind) and isinstance(node.ctx, ast.Store)


def _chain(node: ast.expr) -> tuple[ast.expr, list[str]]:
    """Split `a.b.c` into `a` and [b, c]."""
    attributes: list[str] = []
    while isinstance(node, ast.Attribute):
        attributes.insert(0, node.attr)
        node = node.value
    return node, attributes


def findings(source: str) -> list[str]:
    return Check(ast.parse(source, feature_version=(3, 9))).findings


# ---- the tests


def test_there_are_sources():
    assert PLUGIN / "__init__.py" in SOURCES


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(PLUGIN).as_posix())
def test_source_is_ready_for_qt6_and_python39(path):
    assert findings(path.read_text(encoding="utf-8")) == []


QT = "from qgis.PyQt.QtCore import Qt\n"
CORE = "from qgis.core import *\n".replace("*", "Qgis, QgsMapLayer, QgsProcessingAlgorithm as A")


@pytest.mark.parametrize(
    ("source", "word"),
    [
        (QT + "x = Qt.AlignLeft", "Qt.AlignmentFlag.AlignLeft"),
        ("from qgis.PyQt import QtCore as c\nx = c.Qt.AlignLeft", "Qt.AlignmentFlag.AlignLeft"),
        ("import qgis.core\nx = qgis.core.QgsMapLayer.RasterLayer", "has to be"),
        (CORE + "x = QgsMapLayer.RasterLayer", "has to be"),
        (CORE + "kind = QgsMapLayer\nx = kind.RasterLayer", "has to be"),
        (CORE + "kind = Qgis.MessageLevel\nx = kind.Infos", "does not exist"),
        (CORE + "x = Qgis.Info", "Qgis.MessageLevel.Info"),
        (CORE + "def f(self): return A.FlagSupportsBatch", "has to be"),
        (CORE + "class B(A):\n def flags(self): return self.FlagSupportsBatch", "enumeration"),
        (CORE + "class B(A):\n def flags(self): return super().FlagSupportsBatch", "enumeration"),
        ("from qgis.core import QgsWkbTypes\nx = QgsWkbTypes.PolygonGeometry", "GeometryType"),
        ("from qgis.PyQt.QtCore import QVariant\nx = QVariant.Int", "has to be"),
        ("from qgis.PyQt.QtCore import QVariant\nx = QVariant.Type.Int", "not in Qt 6"),
        (QT + "x = Qt.AlignmentFlag.AlignLaft", "does not exist"),
        (QT + "x = Qt.ItemDataRole.BackgroundColorRole", "not in Qt 6"),
        ("from qgis.core import QgsNothing", "does not exist"),
        ("from qgis.PyQt.QtCore import QRegExp", "not in Qt 6"),
        ("from qgis.PyQt.QtWidgets import QDesktopWidget", "not in Qt 6"),
        ("def f(dialog): dialog.exec_()", "exec_ is not in Qt 6"),
        ("def f(layout): layout.setMargin(0)", "setMargin is not in Qt 6"),
        ("from PyQt5.QtCore import Qt", "qgis.PyQt"),
        ("def f():\n import PyQt6.QtCore", "qgis.PyQt"),
        ("import sip", "qgis.PyQt"),
        ("def f():\n from geomesh.mesh.triangle_mesh import Mesh", "process"),
        ("import numpy as np", "where it is used"),
        ("from osgeo import gdal", "where it is used"),
        ("import tomllib", "3.9"),
    ],
)
def test_check_finds(source, word):
    (found,) = findings(source)
    assert word in found


@pytest.mark.parametrize(
    "source",
    [
        QT + "x = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop",
        "from qgis.PyQt.QtWidgets import QAction, QDialog\nx = QDialog.DialogCode.Accepted",
        "from qgis.PyQt.QtWidgets import QWizard\nx = QWizard.DialogCode.Accepted",
        "from qgis.PyQt.QtCore import QObject, pyqtSignal\nclass A(QObject):\n s = pyqtSignal(int)",
        CORE + "x = Qgis.MessageLevel.Info, Qgis.QGIS_VERSION",
        CORE + "level = Qgis.MessageLevel\nx = level.Info",
        CORE + "a = Qgis.MessageLevel\nx = a.Odd if hasattr(a, 'Odd') else a.Info",
        CORE + "class B(A):\n def flags(self): return super().flags() | A.Flag.FlagSupportsBatch",
        CORE + "x = QgsMapLayer.Sky if hasattr(QgsMapLayer, 'Sky') else None",
        "def f():\n import numpy\n from osgeo import gdal\n return numpy.array(gdal)",
        "import json, os.path\nfrom .runner import run\nfrom . import styling",
        "def f(dialog): dialog.exec()",
    ],
)
def test_check_lets_pass(source):
    assert findings(source) == []


def test_check_refuses_the_syntax_of_python_310():
    with pytest.raises(SyntaxError):
        findings("match 1:\n case 1: pass")
