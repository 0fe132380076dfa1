"""Readers of what `fringe board` writes, by the formats' own definitions: paths, and a picture of them."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from typing import Any, NamedTuple

import numpy as np

MM = 25.4 / 72
_SVG = "{http://www.w3.org/2000/svg}"


class Area(NamedTuple):
    """One closed outline: `grey`, and its corners or the ends and handles of its arcs, (n, 2) mm, y down."""

    grey: float
    kind: str
    points: np.ndarray[Any, Any]


class Drawing(NamedTuple):
    """A page: its size (mm), its areas in order, and its text with the place (mm), size (mm) and grey."""

    size: tuple[float, float]
    areas: list[Area]
    texts: list[tuple[str, float, float, float, float]]


def read_pdf(data: bytes) -> Drawing:
    """Interpret the operators of a page's content, with the matrix that they set."""
    places = [int(found) for found in re.findall(rb"^(\d{10}) 00000 n", data, re.M)]
    for number, place in enumerate(places, 1):
        assert data[place:].startswith(b"%d 0 obj" % number), "the table of objects points elsewhere"
    box = [float(v) for v in re.search(rb"/MediaBox \[(.*?)\]", data).group(1).split()]
    length = int(re.search(rb"/Length (\d+)", data).group(1))
    start = data.index(b"stream\n") + 7
    assert data[start + length :].startswith(b"\nendstream")
    assert re.search(rb"startxref\n(\d+)", data).group(1) == b"%d" % data.index(b"xref\n0 ")
    content = _Content(box[3])
    for line in data[start : start + length].decode("ascii").splitlines():
        content.take(line)
    assert not content.open and not content.outline
    return Drawing((box[2] * MM, box[3] * MM), content.areas, content.texts)


class _Content:
    """A page's content, operator by operator."""

    def __init__(self, height: float) -> None:
        self.height, self.matrix, self.grey = height, np.eye(3), 0.0
        self.areas: list[Area] = []
        self.open: list[Area] = []
        self.outline: list[Any] = []
        self.texts: list[tuple[str, float, float, float, float]] = []
        self.font, self.at = 0.0, np.zeros(2)

    def take(self, line: str) -> None:
        """Do what one line says; each holds one operator."""
        *words, name = line.split()
        if name == "Tj":
            self.texts.append((re.sub(r"\\(.)", r"\1", line[1:-4]), *self.at, self.font, self.grey))
            return
        values = [float(word) for word in words if not word.startswith("/")]
        if name == "cm":
            a, b, c, d, e, f = values
            self.matrix = np.array([[a, b, 0], [c, d, 0], [e, f, 1]]) @ self.matrix
        elif name == "g":
            self.grey = values[0]
        elif name in ("Tf", "Tm", "BT", "ET"):
            self._text(name, values)
        else:
            self._path(name, values)

    def _text(self, name: str, values: list[float]) -> None:
        if name == "Tf":
            self.font = values[0]
        elif name == "Tm":
            assert values[:4] == [1, 0, 0, -1], "letters are upright where y runs down"
            self.at = self._page(values[4:])[0]

    def _path(self, name: str, values: list[float]) -> None:
        if name == "re":
            x, y, w, h = values
            self.open.append(Area(self.grey, "box", self._page([x, y, x + w, y, x + w, y + h, x, y + h])))
        elif name in ("m", "c"):
            self.outline += list(self._page(values))
        elif name == "h":
            self.open.append(Area(self.grey, "arcs", np.array(self.outline)))
            self.outline = []
        else:
            assert name == "f", name
            self.areas, self.open = self.areas + self.open, []

    def _page(self, pairs: list[float]) -> Any:
        """Return page millimetres, y down, of the content's own coordinates."""
        xy = np.column_stack([np.reshape(pairs, (-1, 2)), np.ones(len(pairs) // 2)]) @ self.matrix
        return np.column_stack([xy[:, 0], self.height - xy[:, 1]]) * MM


def read_svg(data: bytes) -> Drawing:
    """Read circles, boxes and text; the view box has to be the size in millimetres."""
    root = ElementTree.fromstring(data)
    size = tuple(float(root.attrib[key].removesuffix("mm")) for key in ("width", "height"))
    assert [float(v) for v in root.attrib["viewBox"].split()] == [0, 0, *size]
    areas, texts = [], []
    for group in root.iter(f"{_SVG}g"):
        grey = int(group.attrib["fill"][1:3], 16) / 255
        for one in group:
            values = {key: one.attrib[key] for key in one.attrib}
            if one.tag == f"{_SVG}circle":
                areas.append(Area(grey, "circle", np.array([[float(values[k]) for k in ("cx", "cy", "r")]])))
            elif one.tag == f"{_SVG}path":
                for box in re.findall(r"M(\S+) ([\d.-]+)H([\d.-]+)V([\d.-]+)H([\d.-]+)Z", values["d"]):
                    x0, y0, x1, y1, again = (float(v) for v in box)
                    assert again == x0
                    areas.append(Area(grey, "box", np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])))
            else:
                texts.append((one.text, float(values["x"]), float(values["y"]), float(values["font-size"]), grey))
    return Drawing(size, areas, texts)


def bezier(points: np.ndarray[Any, Any], samples: int = 16) -> np.ndarray[Any, Any]:
    """Return points (n, 2) on the arcs whose ends and handles are given."""
    t = np.linspace(0, 1, samples, endpoint=False)[:, None]
    arcs = [points[k : k + 4] for k in range(0, len(points) - 1, 3)]
    return np.concatenate(
        [(1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t**2 * (1 - t) * c + t**3 * d for a, b, c, d in arcs]
    )


def picture(drawing: Drawing, px_per_mm: float) -> np.ndarray[Any, Any]:
    """Return the page as grey levels (height, width), text included; pixel (c, r) covers mm c to c + 1 over scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    dpi = 25.4 * px_per_mm
    # Whole pixels: the renderer drops a part of one, and counts from the lower edge.
    shape = np.ceil(np.array(drawing.size) * px_per_mm - 1e-6)
    figure = Figure(figsize=tuple((shape + 1e-3) / dpi), dpi=dpi, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, shape[0] / px_per_mm), ylim=(shape[1] / px_per_mm, 0))
    axes.set_axis_off()
    for grey, kind, points in drawing.areas:
        outline = points
        if kind == "arcs":
            outline = bezier(points)
        elif kind == "circle":
            turn = np.linspace(0, 2 * np.pi, 256, endpoint=False)
            outline = points[0, :2] + points[0, 2] * np.column_stack([np.cos(turn), np.sin(turn)])
        axes.add_patch(Polygon(outline, closed=True, facecolor=str(grey), edgecolor="none", snap=False))
    for text, x, y, size, grey in drawing.texts:
        axes.text(x, y, text, fontsize=size / MM, color=str(grey), va="baseline")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., 0].copy()
