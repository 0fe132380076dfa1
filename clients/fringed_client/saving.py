"""Write what a scan or job has brought into a folder: recordings, point files, its state.

Owns the files' names; the station's exporters write the formats.
"""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringed.errors import NotFound, UsageError
from fringed.tree import split
from fringed_client.files import make_folder, write_aside

if TYPE_CHECKING:
    from fringed_client.results import ScanResult
    from fringed_client.station import Station

SURFACES = ("RangeImage", "Model")


def save_result(station: Station, result: ScanResult, folder: Path) -> list[Path]:
    """Write every set and product as a recording, points as PLY and motions as text too, and `scan.json`.

    Raises
    ------
    StorageError
        the folder cannot be written.
    """
    import msgspec

    make_folder(folder)
    named = dict(result.state.frame_sets)
    named |= {_name(p): str(p["id"]) for p in result.state.products}
    written = [save_recording(station, item_id, folder / name) for name, item_id in named.items()]
    for product in result.state.products:
        if product.get("kind") == "Registration":
            written.append(_matrix_file(result.fetch(str(product["id"])), folder / f"{_name(product)}.txt"))
        if product.get("kind") in SURFACES and _has_points(result.fetch(str(product["id"]))):
            written.append(station.export(product["id"], "ply", folder / f"{_name(product)}.ply"))
    state = json.dumps(msgspec.to_builtins(result.state), indent=2).encode()
    return [*written, write_aside(folder / "scan.json", state)]


def _matrix_file(found: Any, path: Path) -> Path:
    """Write T_reference_model as four rows of numbers; lines that begin with # say what it is."""
    text = io.StringIO()
    said = "converged" if found.converged else f"NOT converged: {found.reason}"
    head = f"T_reference_model: takes points of {found.model} to the frame of {found.reference}\n{said}"
    np.savetxt(text, found.T_reference_model, "%.12g", header=head)
    return write_aside(path, text.getvalue().encode())


def _has_points(surface: Any) -> bool:
    points = surface.points_mm if hasattr(surface, "points_mm") else surface.xyz_mm[surface.rejected == 0]
    return len(points) > 0


def _name(product: Any) -> str:
    return str(product.get("stage") or f"{product.get('kind', 'product')}-{product.get('role', '')}").strip("-").lower()


def save_recording(station: Station, item_id: str, path: Path) -> Path:
    """Copy a recording as `path.h5`, or write `path.npz` where the station's disk is another machine's."""
    source = recording_of(station, item_id)
    if source is None:
        return save_arrays(station.get(item_id), path.with_name(f"{path.name}.npz"))
    return copy_recording(source, path.with_name(f"{path.name}.h5"))


def recording_of(station: Station, item_id: str) -> Path | None:
    """Return the recording's file where this machine sees it."""
    root = Path(station.status().data_dir)
    if len(item_id) < 8 or not item_id[:8].isdigit() or "/" in item_id:
        return None
    return next(iter((root / item_id[:4] / item_id[4:6] / item_id[6:8]).glob(f"{item_id}.*.h5")), None)


def copy_recording(source: Path, path: Path) -> Path:
    """Copy an HDF5 recording; it appears whole or not at all."""
    from fringed.errors import StorageError

    aside = path.with_name(f".{path.name}.part")
    try:
        shutil.copyfile(source, aside)
        return aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise StorageError(f"{path} cannot be written: {error.strerror or error}; choose another --output") from error


def save_arrays(content: Any, path: Path) -> Path:
    """Write every array of a data object, and the rest as JSON under `tree`, as NPZ."""
    arrays: dict[str, Any] = {}
    tree = split(content, "", arrays)
    buffer = io.BytesIO()
    np.savez(buffer, **{name.replace("/", "."): array for name, array in arrays.items()}, tree=json.dumps(tree))
    return write_aside(path, buffer.getbuffer())


def save_as(station: Station, item_id: str, path: Path) -> list[Path]:
    """Write a recording in the format that the file's name asks for.

    `.h5` copies the recording, `.npz` holds its arrays, `.png` draws it, anything else is an exporter. Of an Artifact
    its own content is written, whatever the name.

    Raises
    ------
    UsageError
        a name without an ending.
    NotFound
        no such id, or no exporter of that name.
    """
    suffix = path.suffix.lower().lstrip(".")
    if not suffix:
        raise UsageError(f"{path} has no ending; expected .h5, .npz, .png, .ply, .pcd, .xyz, .stl, .obj or .tiff")
    if suffix in ("h5", "hdf5"):
        source = recording_of(station, item_id)
        if source is None:
            raise NotFound(f"no recording {item_id} on this machine's disk; use .npz, which comes over the network")
        make_folder(path.parent)
        return [copy_recording(source, path)]
    stored = recording_of(station, item_id)
    if stored is not None and ".artifact." in stored.name:
        return [write_aside(path, station.get(item_id).content.data)]
    if suffix == "npz":
        return [save_arrays(station.get(item_id), path)]
    if suffix == "png":
        from fringed_client.pictures.gallery import draw_main

        return [draw_main(station.get(item_id), path)]
    return [station.export(item_id, {"tif": "tiff"}.get(suffix, suffix), path)]
