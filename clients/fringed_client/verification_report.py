"""The report of a verification: one page with the light, the figures, the deviations and what has changed.

Owns how the page looks; everything shown is in the verification and its range image.
"""

from __future__ import annotations

import html
import json
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from fringed import __version__
from fringed.data import Verification
from fringed_client.files import make_folder, write_aside
from fringed_client.pictures.verification import draw_verification
from fringed_client.verification import COLOURS, WORDS, document, range_of, rows, summary, when

if TYPE_CHECKING:
    from fringed_client.station import Station

_PAGE = Template("""<!doctype html>
<html lang="en"><meta charset="utf-8"/><meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>fringed: verification of $calibration</title>
<style>
body { margin: 0 auto; max-width: 1080px; padding: 2rem 1.5rem 4rem; background: #fafaf8; color: #2b2b2b;
       font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; } .light { display: inline-block; width: 1em; height: 1em; border-radius: 50%;
       vertical-align: -.1em; margin-right: .4em; background: $colour; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 1rem 0; }
th, td { padding: .3rem 1rem .3rem 0; text-align: right; border-bottom: 1px solid #e3e2dc; }
th:first-child, td:first-child { text-align: left; } img { max-width: 100%; }
dt { color: #6d6d68; font-size: .85rem; } dd { margin: 0 0 .6rem; white-space: pre-line; }
</style>
<h1><span class="light"></span>$verdict $simulated</h1>
<p>Measured $date (UTC), fringed $software, verification <code>$id</code>. Terms of VDI/VDE 2634 part 2.</p>
<table><tr><th>figure</th><th>mm</th><th>standard uncertainty</th><th>limit</th><th></th></tr>$rows</table>
<img src="verification.png" alt="deviations"/>
<dl>$facts</dl>
""")


def write_report(station: Station, found: Verification, changes: list[str], folder: Path) -> list[Path]:
    """Write `report.html`, `verification.png` and `verification.json`; the page comes first.

    Raises
    ------
    StorageError
        the folder cannot be written.
    """
    make_folder(folder)
    picture = draw_verification(folder / "verification.png", found, range_of(station, found))
    facts = summary(found) | ({"since the last time": "\n".join(changes)} if changes else {})
    page = _PAGE.substitute(
        calibration=html.escape(found.calibration or "an unnamed calibration"), colour=COLOURS[found.verdict],
        verdict=html.escape(f"Calibration {found.calibration or 'unknown'} {WORDS[found.verdict]}"),
        simulated="(SIMULATED)" if found.provenance.simulated else "", date=when(found), software=__version__,
        id=found.id, rows="".join(_row(row) for row in rows(found)),
        facts="".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in facts.items()),
    )  # fmt: skip
    table = write_aside(folder / "verification.json", json.dumps(document(found), indent=1).encode())
    return [write_aside(folder / "report.html", page.encode()), picture, table]


def _row(row: tuple[str, str, str, str, str]) -> str:
    cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in row[:4])
    return f'<tr>{cells}<td style="color:{COLOURS[row[4]]}">{row[4]}: {WORDS[row[4]]}</td></tr>'
