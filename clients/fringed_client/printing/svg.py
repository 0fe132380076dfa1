"""A page as SVG: millimetres as they are, circles as circles."""

from __future__ import annotations

from xml.sax.saxutils import escape

from fringed_client.printing.page import Fill, Page


def svg_of(page: Page) -> bytes:
    """Return the file; its user unit is the millimetre."""
    width, height = f"{page.width_mm:.4f}", f"{page.height_mm:.4f}"
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for fill in page.fills:
        lines += _fill(fill)
    return "\n".join([*lines, "</svg>", ""]).encode()


def _fill(fill: Fill) -> list[str]:
    level = f"{round(255 * fill.grey):02x}"
    lines = [f'<g fill="#{level * 3}" font-family="Helvetica, Arial, sans-serif">']
    lines += [f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{radius:.4f}"/>' for x, y, radius in fill.discs]
    if len(fill.boxes):
        # One path: boxes that touch leave no seam between them.
        boxes = " ".join(f"M{x0:.4f} {y0:.4f}H{x1:.4f}V{y1:.4f}H{x0:.4f}Z" for x0, y0, x1, y1 in fill.boxes)
        lines.append(f'<path d="{boxes}"/>')
    lines += [
        f'<text x="{one.x:.4f}" y="{one.y:.4f}" font-size="{one.size_mm:g}">{escape(one.text)}</text>'
        for one in fill.words
    ]
    return [*lines, "</g>"]
