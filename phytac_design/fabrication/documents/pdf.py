"""A small PDF writer for drawings: no dates, no ids, so the same drawing gives the same bytes.

Text is set in Helvetica, one of the fonts that every viewer and printer has (PDF 1.4).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from phytac_design.fabrication.documents.drawing import Disc, Item, Layer, Line, Page, Text

POINTS = 72.0 / 25.4
"""Points per millimetre."""
ARC = 0.5522847498307936
"""Handle of a Bézier quarter circle over its radius, 4/3·(√2 − 1)."""
WIDTHS = (
    "278 278 355 556 556 889 667 191 333 333 389 584 278 333 278 278 556 556 556 556 556 556 556 "
    "556 556 556 278 278 584 584 584 556 1015 667 667 722 722 667 611 778 722 278 500 667 556 833 "
    "722 778 667 778 722 667 611 722 667 944 667 667 611 278 278 278 469 556 333 556 556 500 556 "
    "556 278 556 556 222 222 500 222 833 556 556 556 556 333 500 278 556 500 722 500 500 500 334 "
    "260 334 584"
)
"""Widths of Helvetica from space to tilde, in thousandths of its size (Adobe's metrics)."""
WIDTH = dict(zip(map(chr, range(32, 127)), map(int, WIDTHS.split()), strict=True))
WIDTH |= {"ø": 611, "×": 584, "°": 400, "±": 584, "·": 278, "–": 556}


def text_width_mm(text: str, size_mm: float) -> float:
    """Width of a line of text."""
    return size_mm * sum(WIDTH.get(letter, 556) for letter in text) / 1000.0


def pdf_bytes(pages: Sequence[Page], *, title: str) -> bytes:
    """PDF of pages of drawings, true to scale."""
    objects: list[bytes] = []
    count = len(pages)
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(count))
    objects.append(b"<< /Type /Catalog /Pages 2 0 R >>")
    objects.append(f"<< /Type /Pages /Kids [{kids}] /Count {count} >>".encode())
    objects.append(
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>"
    )
    for number, page in enumerate(pages):
        width, height = page.width_mm * POINTS, page.height_mm * POINTS
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] "
            f"/Resources << /Font << /F 3 0 R >> >> /Contents {5 + 2 * number} 0 R >>".encode()
        )
        content = page_content(page)
        objects.append(b"<< /Length %d >>\nstream\n" % len(content) + content + b"\nendstream")
    objects.append(b"<< /Title (" + _escaped(title) + b") >>")
    out, places = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"), []
    for number, body in enumerate(objects, start=1):
        places.append(len(out))
        out += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    start = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
    return bytes(out + b"startxref\n%d\n%%%%EOF\n" % start)


def page_content(page: Page) -> bytes:
    """Drawing commands of a page, in millimetres with y downwards."""
    out = [f"{POINTS:.10f} 0 0 {-POINTS:.10f} 0 {page.height_mm * POINTS:.6f} cm".encode()]
    for layer in page.layers:
        out.append(b"q")
        if layer.window is not None:
            (x0, y0), (x1, y1) = layer.window.tolist()
            out.append(f"{x0:.4f} {y0:.4f} {x1 - x0:.4f} {y1 - y0:.4f} re W n".encode())
        out += [_item(item) for item in _seen(layer)]
        out.append(b"Q")
    return b"\n".join(out)


def _seen(layer: Layer) -> list[Item]:
    """Items that reach into the window."""
    if layer.window is None:
        return list(layer.items)
    low, high = layer.window
    return [
        item
        for item in layer.items
        if bool(np.all(item.box[1] >= low) and np.all(item.box[0] <= high))
    ]


def _colour(name: str) -> tuple[float, ...]:
    return tuple(int(name[k : k + 2], 16) / 255.0 for k in (1, 3, 5))


def _item(item: Item) -> bytes:
    if isinstance(item, Text):
        return _text(item)
    if isinstance(item, Line):
        (x, y), *rest = item.points.tolist()
        path = f"{x:.3f} {y:.3f} m " + " ".join(f"{a:.3f} {b:.3f} l" for a, b in rest)
        path += " h" if item.closed else ""
    else:
        path = _circle(item)
    return (_style(item) + path + " " + _paint(item.stroke, item.fill)).encode()


def _style(item: Line | Disc) -> str:
    out = ""
    if item.fill:
        out += "{:.4f} {:.4f} {:.4f} rg ".format(*_colour(item.fill))
    if item.stroke:
        out += "{:.4f} {:.4f} {:.4f} RG ".format(*_colour(item.stroke))
        out += (
            f"{item.width_mm:.4f} w [{item.dash_mm:g}] 0 d "
            if item.dash_mm
            else (f"{item.width_mm:.4f} w [] 0 d ")
        )
    return out


def _paint(stroke: str, fill: str) -> str:
    if stroke and fill:
        return "B"
    return "S" if stroke else "f"


def _circle(disc: Disc) -> str:
    (x, y), r = disc.centre.tolist(), disc.radius_mm
    corners = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]
    out = f"{x + r:.3f} {y:.3f} m "
    for (ax, ay), (bx, by) in pairwise(corners):
        handles = (ax + ARC * bx, ay + ARC * by, bx + ARC * ax, by + ARC * ay, bx, by)
        out += " ".join(f"{(x, y)[k % 2] + r * h:.3f}" for k, h in enumerate(handles)) + " c "
    return out + "h"


def _text(item: Text) -> bytes:
    share = {"start": 0.0, "middle": 0.5, "end": 1.0}[item.anchor]
    back = share * text_width_mm(item.text, item.size_mm)
    c, s = np.cos(np.radians(item.turn_deg)), np.sin(np.radians(item.turn_deg))
    x, y = item.at + back * np.array([-c, s])
    size = item.size_mm
    matrix = (size * c, -size * s, -size * s, -size * c, x, y)
    head = "{:.4f} {:.4f} {:.4f} rg BT /F 1 Tf ".format(*_colour(item.colour))
    head += " ".join(f"{value:.5f}" for value in matrix) + " Tm ("
    return head.encode() + _escaped(item.text) + b") Tj ET"


def _escaped(text: str) -> bytes:
    plain = text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    return plain.encode("cp1252", errors="replace")
