"""Changing attributes of an XML file as text, so that everything else of it stays as its author wrote it.

An XML library writes back what it understood: quotes, line breaks, the order of attributes, comments outside the root
and name space prefixes are lost. Here expat only says where the elements are; the bytes between are not touched.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr


@dataclass
class Node:
    """One element: tag, attributes and where its bytes are (start tag from ``begin`` to ``opened``, all to ``end``)."""

    tag: str
    attributes: dict[str, str]
    begin: int
    opened: int
    end: int = 0
    children: list[Node] = field(default_factory=list)

    def child(self, tag: str) -> Node | None:
        """The first child with that tag."""
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> Iterator[Node]:
        """Children with that tag."""
        return (c for c in self.children if c.tag == tag)


class XmlText:
    """An XML file that is read once and changed in places; :meth:`content` gives the changed bytes."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._edits: list[tuple[int, int, bytes]] = []
        self.root = self._parse()

    def _parse(self) -> Node:
        parser = expat.ParserCreate()
        stack: list[Node] = []
        roots: list[Node] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            begin = parser.CurrentByteIndex
            node = Node(tag, attributes, begin, self._tag_end(begin))
            (stack[-1].children if stack else roots).append(node)
            stack.append(node)

        def end(tag: str) -> None:
            node = stack.pop()
            closed = self._content[node.opened - 2 : node.opened] == b"/>"
            node.end = node.opened if closed else self._content.index(b">", parser.CurrentByteIndex) + 1

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(self._content, True)
        return roots[0]

    def _tag_end(self, begin: int) -> int:
        """Index after the ``>`` of the start tag at ``begin``; one within quotes does not count."""
        quote = 0
        for k in range(begin, len(self._content)):
            byte = self._content[k]
            if quote:
                quote = 0 if byte == quote else quote
            elif byte in b"\"'":
                quote = byte
            elif byte == ord(">"):
                return k + 1
        raise ValueError("the XML breaks off within a tag")

    def set_attributes(self, node: Node, values: dict[str, str]) -> None:
        """Set attributes of ``node``: changed in place where they are, added at the end of the tag where not."""
        text = self._content[node.begin : node.opened].decode("utf-8", "surrogateescape")
        for name, value in values.items():
            found = re.search(rf"(?<![\w:.-]){re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')", text)
            if found:
                text = text[: found.start(1)] + quoteattr(value) + text[found.end(1) :]
            else:
                tail = re.search(r"\s*/?>$", text)
                assert tail is not None
                text = f"{text[: tail.start()]} {name}={quoteattr(value)}{tail.group().lstrip()}"
        self._edits.append((node.begin, node.opened, text.encode("utf-8", "surrogateescape")))

    def append(self, node: Node, text: str) -> None:
        """Put the element ``text`` behind the last child of ``node``, on a line of its own."""
        lead = self._indentation(node.children[0].begin if node.children else node.begin)
        if not node.children:
            lead += "  "
        if node.end == node.opened:  # <tag/>: it gets an end tag
            head = (
                self._content[node.begin : node.opened].decode("utf-8", "surrogateescape").removesuffix("/>").rstrip()
            )
            own = self._indentation(node.begin)
            whole = f"{head}>\n{lead}{text}\n{own}</{node.tag}>"
            self._edits.append((node.begin, node.opened, whole.encode("utf-8", "surrogateescape")))
            return
        at = node.children[-1].end if node.children else node.opened
        self._edits.append((at, at, f"\n{lead}{text}".encode()))

    def head(self, lines: list[str]) -> None:
        """Put a comment of ``lines`` before the root element."""
        text = "\n".join(f"  {line}".rstrip() for line in lines).replace("--", "- -")
        self._edits.append((self.root.begin, self.root.begin, f"<!--\n{text}\n-->\n".encode()))

    def _indentation(self, at: int) -> str:
        line = self._content[self._content.rfind(b"\n", 0, at) + 1 : at]
        return line.decode() if not line.strip() else ""

    def content(self) -> bytes:
        """The file with all changes."""
        out = self._content
        for begin, end, text in sorted(self._edits, key=lambda edit: (edit[0], edit[1]), reverse=True):
            out = out[:begin] + text + out[end:]
        return out
