"""HTML for notebooks: a data object with its thumbnail and its few telling figures.

Owns the text; the pictures come from `pictures.thumbs`.
"""

from __future__ import annotations

import base64
import html
from typing import TYPE_CHECKING, Any

import numpy as np

from fringed.data import BoardView, Calibration, FrameSet, Model, PhaseMap, RangeImage, Registration, Verification
from fringed_client.pictures.thumbs import png, thumbnail

if TYPE_CHECKING:
    from fringed_client.results import ScanResult

_SIMULATED = '<b style="color:#b3541e">SIMULATED</b>'


def show(content: Any, width_px: int = 360) -> str:
    """Return HTML of a data object or message: its thumbnail, where it has one, and its figures."""
    picture = thumbnail(content, width_px)
    image = "" if picture is None else f'<img alt="{type(content).__name__}" src="{data_url(png(picture))}"/>'
    rows = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in facts(content).items())
    provenance = getattr(content, "provenance", None)
    mark = f" {_SIMULATED}" if getattr(provenance, "simulated", False) else ""
    return (
        f'<div style="display:inline-block;margin:.5em;vertical-align:top"><b>{type(content).__name__}</b>{mark}'
        f"<br/>{image}<table>{rows}</table></div>"
    )


def data_url(content: bytes, media_type: str = "image/png") -> str:
    """Return bytes as a URL that holds them."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode()}"


def facts(content: Any) -> dict[str, str]:
    """Return the few figures that tell what an object is."""
    found = {"id": content.id} if getattr(content, "id", "") else {}
    if isinstance(content, FrameSet):
        count, height, width = content.frames.shape
        found |= {"role": content.role, "frames": f"{count} of {width} x {height}, {content.frames.dtype}"}
        found["patterns"] = content.sequence.family
        if content.retakes:
            found["retakes"] = str(content.retakes)
    elif isinstance(content, PhaseMap):
        found |= {"phase": f"{content.kind}, period {content.period_px:g} px", "kept": _kept(content.rejected)}
    elif isinstance(content, BoardView):
        found |= {
            "pose": content.name or "unnamed",
            "board": f"{len(content.index)} points" if content.found else "none",
        }
        found |= {"because": content.reason} if content.reason else {}
    elif isinstance(content, Calibration):
        from fringed_client.calibration.figures import accuracy_rows

        found |= {key: text for key, text in accuracy_rows(content).items() if key != "calibration"}
    elif isinstance(content, Verification):
        from fringed_client.verification import rows, summary

        found |= {
            "verdict": content.verdict,
            **{row[0]: f"{row[1]} mm, limit {row[3]}: {row[4]}" for row in rows(content)},
        }
        found |= summary(content)
    elif isinstance(content, RangeImage):
        found |= {"size": "{1} x {0}".format(*content.rejected.shape), "kept": _kept(content.rejected)}
        found["z"] = _span(content.xyz_mm[..., 2])
        if content.sigma_mm is not None and np.isfinite(content.sigma_mm).any():
            found["median sigma"] = f"{np.nanmedian(content.sigma_mm) * 1000:.0f} um"
    elif isinstance(content, Model):
        found |= {"points": f"{len(content.points_mm):,}", "views": str(len(content.views))}
    elif isinstance(content, Registration):
        found |= {"converged": f"{content.converged}: {content.reason}", "rms": f"{content.rms_mm:.3f} mm"}
        found["overlap"] = f"{content.overlap:.0%}"
    return found


def result_html(result: ScanResult) -> str:
    """Return a scan's state, the frame sets and the products that have a picture."""
    state = result.state
    timings = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in state.timings_s.items())
    shown = [*result.frame_sets.values(), *result.products.values()]
    return (
        f"<div><b>{html.escape(state.pipeline)}</b> <code>{state.id}</code> {state.state}<br/>"
        f"<small>{html.escape(timings)}</small><br/>{''.join(show(item) for item in shown)}</div>"
    )


def _kept(rejected: Any) -> str:
    return f"{np.count_nonzero(rejected == 0):,} of {rejected.size:,} pixels ({np.mean(rejected == 0):.0%})"


def _span(values: Any) -> str:
    kept = values[np.isfinite(values)]
    return f"{kept.min():.1f} to {kept.max():.1f} mm" if kept.size else "nothing"
