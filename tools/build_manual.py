"""Make the manual inside the extension: docs/reference/blender.md as one HTML page, and a small file for each section
that leads to it.

python tools/build_manual.py OUT      (OUT: the folder `manual`)
"""

from __future__ import annotations

import html
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "docs" / "reference" / "blender.md"
TITLE = "UniSim in Blender"
STYLE = (
    "body{font:16px/1.55 system-ui,sans-serif;max-width:48rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}"
    "img{max-width:100%;border-radius:4px}code{background:#eee;padding:.1em .3em;border-radius:3px}"
    "pre{background:#eee;padding:.6em;overflow:auto}pre code{padding:0}table{border-collapse:collapse}"
    "td,th{border:1px solid #bbb;padding:.3em .6em;text-align:left;vertical-align:top}nav a{margin-right:1em}"
    "@media(prefers-color-scheme:dark){body{color:#ddd;background:#1d1d1d}code,pre{background:#333}a{color:#8bf}}"
)
ITEM = re.compile(r"(\s*)(?:([-*])|\d+\.)\s+(.*)")


def anchor_of(heading: str) -> str:
    """Return a heading's anchor: lower case, words joined by hyphens, as code hosts make them."""
    return re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())


def inline(text: str) -> str:
    """Return a line's code, links, images, bold and italic words as HTML."""
    codes: list[str] = []

    def keep(found: re.Match[str]) -> str:
        codes.append(f"<code>{html.escape(found[1], quote=False)}</code>")
        return f"\0{len(codes) - 1}\0"

    text = html.escape(re.sub(r"`([^`]+)`", keep, text), quote=False)
    text = re.sub(r"!\[([^\]]*)\]\(([^)]+)\)", lambda m: f'<img src="{m[2]}" alt="{html.escape(m[1])}">', text)
    text = re.sub(r"\[([^\]]+)\]\(([^)]+)\)", lambda m: link(m[1], m[2]), text)
    text = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", text)
    text = re.sub(r"(?<![\w*])\*([^*\s][^*]*)\*(?![\w*])", r"<em>\1</em>", text)
    return re.sub(r"\0(\d+)\0", lambda m: codes[int(m[1])], text)


def link(text: str, target: str) -> str:
    """Return a link; other documents of the project are not inside the extension, and are named alone."""
    return f'<a href="{target}">{text}</a>' if target.startswith(("#", "http://", "https://")) else text


def blocks(lines: list[str]) -> Iterator[str]:
    """Yield headings, paragraphs, lists, tables and code as HTML."""
    at = 0
    while at < len(lines):
        line = lines[at]
        if not line.strip():
            at += 1
        elif line.startswith("```"):
            end = next(i for i in range(at + 1, len(lines)) if lines[i].startswith("```"))
            yield f"<pre><code>{html.escape(chr(10).join(lines[at + 1 : end]), quote=False)}</code></pre>"
            at = end + 1
        elif found := re.match(r"(#{1,4}) (.*)", line):
            level = len(found[1])
            yield f'<h{level} id="{anchor_of(found[2])}">{inline(found[2])}</h{level}>'
            at += 1
        elif line.startswith("|"):
            end = next((i for i in range(at, len(lines)) if not lines[i].startswith("|")), len(lines))
            yield table(lines[at:end])
            at = end
        elif ITEM.match(line):
            end = next((i for i in range(at, len(lines)) if ends_list(lines, i, kind_of(line))), len(lines))
            yield listing(lines[at:end])
            at = end
        else:
            end = next((i for i in range(at + 1, len(lines)) if begins_block(lines[i])), len(lines))
            yield f"<p>{inline(' '.join(part.strip() for part in lines[at:end]))}</p>"
            at = end


def begins_block(line: str) -> bool:
    """Whether a line ends the paragraph before it."""
    return not line.strip() or line.startswith(("#", "|", "```")) or ITEM.match(line) is not None


def kind_of(line: str) -> str:
    """Return the kind of list whose item a line begins; "" where it is none."""
    found = ITEM.match(line)
    return "" if found is None else "ul" if found[2] else "ol"


def ends_list(lines: list[str], at: int, kind: str) -> bool:
    """Whether a line lies behind a list of a kind: no item, not indented, or empty before something else."""
    line = lines[at]
    if not line.strip():
        after = lines[at + 1] if at + 1 < len(lines) else ""
        return kind_of(after) != kind and not after.startswith("  ")
    return not (ITEM.match(line) or line.startswith("  "))


def listing(lines: list[str]) -> str:
    """Return a list's lines as HTML; items that are further in are a list inside the item before them."""
    found = ITEM.match(lines[0])
    assert found is not None
    indent, kind = len(found[1]), kind_of(lines[0])
    items: list[list[str]] = []
    for line in lines:
        item = ITEM.match(line)
        if item is not None and len(item[1]) == indent:
            items.append([item[3]])
        elif line.strip():
            items[-1].append(line)
    made = []
    for first, *rest in items:
        inner = next((i for i, line in enumerate(rest) if ITEM.match(line)), len(rest))
        text = inline(" ".join([first, *(line.strip() for line in rest[:inner])]))
        made.append(f"<li>{text}{listing(rest[inner:]) if inner < len(rest) else ''}</li>")
    return f"<{kind}>{''.join(made)}</{kind}>"


def table(lines: list[str]) -> str:
    """Return a table's lines as HTML; the second line parts the head from the rest."""
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))] for line in lines]
    head = "".join(f"<th>{inline(cell)}</th>" for cell in rows[0])
    body = "".join(f"<tr>{''.join(f'<td>{inline(cell)}</td>' for cell in row)}</tr>" for row in rows[2:])
    return f"<table><tr>{head}</tr>{body}</table>"


def page(markdown: str) -> str:
    """Return a document as one HTML page that needs nothing else but its images."""
    lines = markdown.splitlines()
    chapters = [line[3:] for line in lines if line.startswith("## ")]
    contents = "".join(f'<a href="#{anchor_of(name)}">{inline(name)}</a>' for name in chapters)
    body = list(blocks(lines))
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body>\n'
        + "\n".join([*body[:1], f"<nav>{contents}</nav>", *body[1:]])
        + "\n</body></html>\n"
    )


def anchors(text: str) -> list[str]:
    """Return a page's anchors."""
    return re.findall(r'<h\d id="([^"]+)"', text)


def build(out: Path, source: Path = SOURCE) -> Path:
    """Write the manual into a folder; return its page."""
    out.mkdir(parents=True, exist_ok=True)
    text = page(source.read_text(encoding="utf-8"))
    for name in set(re.findall(r'<img src="([^"]+)"', text)):
        image = f"images/{Path(name).name}"
        (out / image).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source.parent / name, out / image)
        text = text.replace(f'<img src="{name}"', f'<img src="{image}"')
    for anchor in anchors(text):
        leads = (
            f'<!DOCTYPE html>\n<meta charset="utf-8"><meta http-equiv="refresh" content="0; url=index.html#{anchor}">'
        )
        (out / f"{anchor}.html").write_text(f'{leads}\n<a href="index.html#{anchor}">{TITLE}</a>\n', encoding="utf-8")
    (out / "index.html").write_text(text, encoding="utf-8")
    return out / "index.html"


if __name__ == "__main__":
    print(build(Path(sys.argv[1])))
