"""A page as PDF 1.6, vectors only, and the wish that no viewer scales it.

Owns the file's objects and the circle's arcs. Numbers have four decimals of a millimetre; a circle of eight Bezier
arcs is off by 4e-6 of its radius.
"""

from __future__ import annotations

import math

from fringed.errors import UsageError
from fringed_client.printing.page import Fill, Page

_POINT_MM = 25.4 / 72
_LARGEST_MM = 14_400 * _POINT_MM  # ISO 32000-1, annex C: a page has at most 14,400 units
_ARCS = 8


def pdf_of(page: Page) -> bytes:
    """Return the file.

    Raises
    ------
    UsageError
        a page that is larger than PDF allows.
    """
    if max(page.width_mm, page.height_mm) > _LARGEST_MM:
        raise UsageError(
            f"a page of {page.width_mm:g} x {page.height_mm:g} mm is larger than PDF's {_LARGEST_MM:g} mm; write .svg"
        )
    width, height = page.width_mm / _POINT_MM, page.height_mm / _POINT_MM
    scale = 1 / _POINT_MM
    # From here on units are millimetres and y runs down, as everywhere else.
    lines = [f"{scale:.9f} 0 0 {-scale:.9f} 0 {height:.6f} cm"]
    for fill in page.fills:
        lines += _fill(fill)
    content = "\n".join(lines).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.6f} {height:.6f}] /Contents 4 0 R "
        f"/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Title (%s) /Creator (fringe board) >>" % _escaped(page.title).encode("ascii"),
    ]
    return _file(objects)


def _file(objects: list[bytes]) -> bytes:
    data = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n")
    places = []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    start = len(data)
    data += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    data += b"".join(b"%010d 00000 n \n" % place for place in places)
    data += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
    return bytes(data + b"startxref\n%d\n%%%%EOF\n" % start)


def _fill(fill: Fill) -> list[str]:
    lines = [f"{fill.grey:g} g"]
    for x, y, radius in fill.discs:
        lines += _circle(float(x), float(y), float(radius))
    lines += [f"{x0:.4f} {y0:.4f} {x1 - x0:.4f} {y1 - y0:.4f} re" for x0, y0, x1, y1 in fill.boxes]
    if len(lines) > 1:
        lines.append("f")  # one path: boxes that touch leave no seam between them
    for one in fill.words:
        # The matrix turns the letters upright again.
        lines += ["BT", f"/F {one.size_mm:g} Tf", f"1 0 0 -1 {one.x:.4f} {one.y:.4f} Tm", f"({_escaped(one.text)}) Tj"]
        lines.append("ET")
    return lines


def _circle(x: float, y: float, radius: float) -> list[str]:
    step = 2 * math.pi / _ARCS
    reach = 4 / 3 * math.tan(step / 4) * radius
    lines = [f"{x + radius:.4f} {y:.4f} m"]
    for k in range(_ARCS):
        c0, s0, c1, s1 = math.cos(k * step), math.sin(k * step), math.cos((k + 1) * step), math.sin((k + 1) * step)
        numbers = (
            x + radius * c0 - reach * s0, y + radius * s0 + reach * c0, x + radius * c1 + reach * s1,
            y + radius * s1 - reach * c1, x + radius * c1, y + radius * s1,
        )  # fmt: skip
        lines.append(" ".join(f"{number:.4f}" for number in numbers) + " c")
    return [*lines, "h"]


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
