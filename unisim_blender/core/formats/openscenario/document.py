"""The elements of an OpenSCENARIO file: their attributes with parameters in place, catalogs, and what nobody read.

Whatever is read is noted. What is not is listed at the end, by its element and its name, so that no attribute and no element is
left out in silence.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

from ...errors import ScenarioError, in_a_line, refused, short
from .expressions import ExpressionError, Scope, text_of

MOST_BYTES = 64 << 20
MOST_CATALOG_FILES = 200
WITHOUT_EFFECT = frozenset(("name", "description", "parameterType", "variableType", "conditionEdge"))
"""Attributes that say nothing of where an entity is, or that are read where they matter."""
SILENT = frozenset(("FileHeader", "ParameterDeclarations", "CatalogLocations"))
"""Elements whose every content is read elsewhere or says nothing of the drive."""
EMPTY_IS_NOTHING = frozenset(("RoadNetwork", "Properties", "StopTrigger", "StartTrigger", "VariableDeclarations"))
_DECLARED = re.compile(rb"""^(\s*<\?xml\s+version\s*=\s*["'])1\.[1-9](["'])""")
ReadT = TypeVar("ReadT")
TRUTHS = {"true": True, "1": True, "false": False, "0": False}


class NotUnderstoodError(Exception):
    """A part of a file that is valid and not understood. The message names it."""


class Document:
    """A file, its catalogs, and the sentences about it. Raises `ScenarioError` for what is no OpenSCENARIO 1.x."""

    def __init__(self, path: Path, root: Element) -> None:
        self.path, self.root = path, root
        self.sentences: dict[tuple[str, str], None] = {}
        self._attributes: set[tuple[int, str]] = set()
        self._visited: set[int] = set()
        self._settled: set[int] = set()
        self._catalogs: dict[tuple[str, str], tuple[Element, Path] | None] | None = None
        self._roots: list[tuple[Element, str]] = [(root, "")]
        self.node = XmlNode(self, root, Scope(), "")

    def say(self, sentence: str, place: str = "") -> None:
        """Note a sentence; those that differ by their places alone are given together."""
        self.sentences.setdefault((place, sentence))

    def losses(self) -> list[str]:
        """Return all sentences, those about unread parts at the end."""
        places: dict[str, list[str]] = {}
        for place, sentence in self.sentences:
            places.setdefault(sentence, []).append(place)
        losses = []
        for sentence, where in places.items():
            others, more = ", ".join(where[1:4]), len(where) - 4
            many = f" (and at {others}{f' and {more} more places' if more > 0 else ''})" if others else ""
            losses.append(f"{where[0]}: {sentence}{many}" if where[0] else f"{sentence}{many}")
        return losses + self._unread()

    def settle(self, element: Element) -> None:
        """Note that a sentence, or another reader, has dealt with an element and all that it holds."""
        self._settled.add(id(element))

    def visit(self, element: Element) -> None:
        """Note that an element was read."""
        self._visited.add(id(element))

    def saw(self, element: Element, name: str) -> None:
        """Note that an attribute was read."""
        self._attributes.add((id(element), name))

    def catalog_entry(self, reference: XmlNode) -> XmlNode:
        """Return the entry that a CatalogReference names, its parameters set. Raises `NotUnderstoodError`."""
        if self._catalogs is None:
            self._catalogs = dict(self._read_catalogs(reference.scope))
        key = reference.text("catalogName"), reference.text("entryName")
        given = {
            assignment.name_in("parameterRef"): assignment.text("value")
            for holder in reference.children("ParameterAssignments")
            for assignment in holder.children("ParameterAssignment")
        }
        entry = self._catalogs.get(key)
        if entry is None:
            wanted = f"{short(key[1])} of the catalog {short(key[0])}"
            raise NotUnderstoodError(f"CatalogReference to {wanted} (which no file of CatalogLocations has)")
        element, _ = entry
        if all(element is not root for root, _ in self._roots):
            self._roots.append((element, f"catalog {key[0]}"))
        self.visit(element)
        node = XmlNode(self, element, Scope({}, reference.scope), reference.place)
        return node.declaring(given)

    def _read_catalogs(self, scope: Scope) -> Iterator[tuple[tuple[str, str], tuple[Element, Path]]]:
        """Give the entries of all catalogs by catalog and name. What is no catalog is said."""
        read = 0
        for directory in self.root.findall("CatalogLocations//Directory"):
            try:
                folder = self.path.parent / text_of(scope.value(directory.get("path", "")))
            except ExpressionError as fault:
                self.say(f"CatalogLocations: {short(directory.get('path'))} ({fault}) is not understood")
                continue
            try:
                files = [folder] if folder.is_file() else sorted(folder.glob("*.xosc"))
            except OSError as error:
                self.say(f"CatalogLocations: {folder}: cannot be read: {error.strerror}")
                continue
            for file in files:
                read += 1
                if read > MOST_CATALOG_FILES:
                    raise ScenarioError(f"{self.path}: CatalogLocations: more than {MOST_CATALOG_FILES} files")
                try:
                    catalogs = parsed(file).findall("Catalog")
                except ScenarioError as fault:
                    self.say(f"CatalogLocations: {fault}")
                    continue
                for catalog in catalogs:
                    for entry in catalog:
                        yield (catalog.get("name", ""), entry.get("name", "")), (entry, file)

    def _unread(self) -> list[str]:
        unread: dict[str, dict[str, int]] = {}
        for root, _ in self._roots:
            self._collect(root, unread)
        sentences = []
        for parent, names in unread.items():
            listed = ", ".join(name if count == 1 else f"{name} ({count} times)" for name, count in names.items())
            sentences.append(f"{parent}: not read: {listed}")
        return sentences

    def _collect(self, element: Element, by_parent: dict[str, dict[str, int]]) -> None:
        if id(element) in self._settled:
            return
        unread = [
            f"{name}={short(value)}"
            for name, value in element.attrib.items()
            if not name.startswith("{") and name not in WITHOUT_EFFECT and (id(element), name) not in self._attributes
        ]
        visited = []
        for child in element:
            if not isinstance(child.tag, str) or child.tag in SILENT or id(child) in self._settled:
                continue
            if id(child) in self._visited:
                visited.append(child)
            elif len(child) or child.attrib or child.tag not in EMPTY_IS_NOTHING:
                unread.append(child.tag)
        for name in unread:
            names = by_parent.setdefault(element.tag, {})
            names[name] = names.get(name, 0) + 1
        for child in visited:
            self._collect(child, by_parent)


class XmlNode:
    """An element with the parameters that are declared there, and its place in the storyboard for sentences."""

    def __init__(self, document: Document, element: Element, scope: Scope, place: str, declared: bool = False) -> None:
        self.document, self.element, self.scope, self.place = document, element, scope, place
        self._declared = declared
        document.visit(element)

    @property
    def tag(self) -> str:
        return self.element.tag

    def has(self, name: str) -> bool:
        """Whether an attribute is given."""
        return name in self.element.attrib

    def text(self, name: str, default: str | None = None) -> str:
        """Return an attribute's value, parameters and expressions in place. Raises `NotUnderstoodError` where it is missing, or
        has no value."""
        self.document.saw(self.element, name)
        value = self.element.get(name, default)
        if value is None:
            raise NotUnderstoodError(f"{self.tag} without {name}")
        try:
            return text_of(self.scope.value(value))
        except ExpressionError as fault:
            raise NotUnderstoodError(f"{self.tag}: {name}: the expression {short(value)} ({fault})") from None

    def name_in(self, attribute: str) -> str:
        """Return the parameter's or variable's name that an attribute gives: ``$`` before it is no value to put in place. Raises
        `NotUnderstoodError` where it is missing."""
        self.document.saw(self.element, attribute)
        name = self.element.get(attribute)
        if name is None:
            raise NotUnderstoodError(f"{self.tag} without {attribute}")
        return name.removeprefix("$")

    def choice(self, name: str, values: tuple[str, ...], default: str | None = None) -> str:
        """Return an attribute that is one of a few names. Raises `NotUnderstoodError` for another one."""
        value = self.text(name, default)
        if value not in values:
            raise NotUnderstoodError(f"{self.tag} with the {name} {short(value)}")
        return value

    def truth(self, name: str, default: str | None = None) -> bool:
        """Return a boolean. Raises `ScenarioError`."""
        value = self.text(name, default)
        if value.lower() not in TRUTHS:
            raise ScenarioError(f"{self.document.path}: {self.tag}: {name} must be true or false, not {short(value)}")
        return TRUTHS[value.lower()]

    def number(self, name: str, default: str | None = None) -> float:
        """Return a finite number. Raises `ScenarioError`."""
        value = self.text(name, default)
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or abs(number) > 1e9:
            raise ScenarioError(f"{self.document.path}: {self.tag}: {name} must be a finite number, not {short(value)}")
        return number

    def optional_number(self, name: str) -> float | None:
        """Return a finite number; None where the attribute is not given. Raises `ScenarioError`."""
        return self.number(name) if self.has(name) else None

    def child(self, *tags: str) -> XmlNode | None:
        """Return the element below that a chain of names leads to."""
        node: XmlNode = self
        for tag in tags:
            element = node.element.find(tag)
            if element is None:
                return None
            node = XmlNode(self.document, element, node.scope, self.place)
        return node

    def required(self, tag: str) -> XmlNode:
        """Return the element below of a name. Raises `ScenarioError` where there is none."""
        child = self.child(tag)
        if child is None:
            raise ScenarioError(f"{self.document.path}: {self.tag}: has no {tag}")
        return child

    def child_or_entry(self, tag: str) -> XmlNode | None:
        """Return the element below of a name, or the catalog's entry that is given in its place. Raises `NotUnderstoodError`."""
        child, reference = self.child(tag), self.child("CatalogReference")
        return self.document.catalog_entry(reference) if child is None and reference is not None else child

    def children(self, tag: str | None = None) -> list[XmlNode]:
        """Return the elements below, of a name."""
        every = [child for child in self.element if isinstance(child.tag, str) and tag in (None, child.tag)]
        return [XmlNode(self.document, child, self.scope, self.place) for child in every]

    def at(self, place: str) -> XmlNode:
        """Return the same element as one of another place."""
        return XmlNode(self.document, self.element, self.scope, place, self._declared)

    def declaring(self, given: dict[str, str] | None = None) -> XmlNode:
        """Return the same element with the parameters that it declares; ``given`` values come before declared ones."""
        if self._declared:
            return self
        own = {}
        for parameter in self.element.findall("ParameterDeclarations/ParameterDeclaration"):
            own[parameter.get("name", "")] = parameter.get("value", "")
            if parameter.find("ConstraintGroup") is not None:
                self.document.say("ParameterDeclaration: ConstraintGroup is not checked")
        for holder in self.element.findall("ParameterDeclarations"):
            self.document.settle(holder)
        scope = Scope(own, self.scope)
        if given:
            # what a reference gives was evaluated where the reference is
            scope.own.update(given)
        return XmlNode(self.document, self.element, scope, self.place, True)

    def settled(self) -> None:
        """Note that this element and all that it holds were dealt with."""
        self.document.settle(self.element)


def innermost(element: Element) -> str:
    """Return the tag of the innermost action, condition, position or shape of an element; that of an action or a condition has
    no positions in it."""
    ends: tuple[str, ...] = ("Action", "Condition", "Position", "Nurbs", "Clothoid", "ClothoidSpline", "Shape")
    for own in ("Action", "Condition"):
        if element.tag.endswith(own):
            ends = (own,)
    deepest = element
    while True:
        inner = next((child for child in deepest if isinstance(child.tag, str) and child.tag.endswith(ends)), None)
        if inner is None:
            return deepest.tag
        deepest = inner


def read_child(node: XmlNode, readers: Mapping[tuple[str, ...], Callable[[XmlNode], ReadT]]) -> ReadT:
    """Return what the first reader gives whose chain of names leads to an element below. Raises `NotUnderstoodError` where none
    does."""
    for tags, read in readers.items():
        child = node.child(*tags)
        if child is not None:
            return read(child)
    raise NotUnderstoodError(innermost(node.element))


def xml_root(path: Path) -> Element:
    """Return the root of an XML file. Raises `ScenarioError`; entities of its own are refused unread."""
    with refused(path, "read", ScenarioError):
        if os.path.getsize(path) > MOST_BYTES:
            raise ScenarioError(f"{path}: has {os.path.getsize(path)} bytes, more than {MOST_BYTES}")
        data = path.read_bytes()
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ScenarioError(f"{path}: has a DOCTYPE or entities of its own, which are not read")
    # the parser knows version 1.0 of XML alone; others differ in what names and control characters may be
    data = _DECLARED.sub(rb"\g<1>1.0\g<2>", data, count=1)
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise ScenarioError(f"{path}: is no XML: {in_a_line(error)}") from error


def parsed(path: Path) -> Element:
    """Return the root of an OpenSCENARIO file. Raises `ScenarioError`."""
    root = xml_root(path)
    if root.tag != "OpenSCENARIO":
        raise ScenarioError(f"{path}: is no OpenSCENARIO: its root is {short(root.tag)}")
    header = root.find("FileHeader")
    if header is None or header.get("revMajor") != "1":
        stated = "no version" if header is None else f"version {header.get('revMajor')}.{header.get('revMinor')}"
        raise ScenarioError(f"{path}: FileHeader: revMajor must be 1: it states {stated}, and 1.0 to 1.3 are read")
    return root
