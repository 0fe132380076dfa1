"""Find and load plug-ins, one at a time: a broken one is listed with its error and harms nobody.

Owns entry points, plug-in folders and the catalogue of what they provide. Nobody in the daemon's own
process calls it, except for a device driver that the configuration names.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pluggy

from fringed import hookspecs
from fringed.errors import NotFound, PluginError
from fringed.messages import PluginInfo

_KIND_OF_HOOK = {
    "register_patterns": "encoder",
    "register_processors": "processor",
    "register_cameras": "camera",
    "register_projectors": "projector",
    "register_scenes": "scene",
    "register_exporters": "exporter",
    "register_commands": "command",
}
_CONTRACT = {
    "encoder": hookspecs.Encoder,
    "processor": hookspecs.Processor,
    "scene": hookspecs.SceneMaker,
    "exporter": hookspecs.Exporter,
}


@dataclass
class Catalogue:
    """What the loaded plug-ins provide, by kind and name."""

    plugins: list[PluginInfo] = field(default_factory=list)
    provided: dict[str, dict[str, Any]] = field(default_factory=dict)

    def get(self, kind: str, name: str) -> Any:
        """Return what was registered under `name`.

        Raises
        ------
            NotFound
            nothing of that kind has that name; the message lists those that exist.
        """
        found = self.provided.get(kind, {})
        if name not in found:
            broken = "".join(f"; {p.name} is broken: {p.error.splitlines()[-1]}" for p in self.plugins if p.error)
            raise NotFound(f"no {kind} is called {name!r}; there are {', '.join(sorted(found)) or 'none'}{broken}")
        return found[name]


def load_plugins(
    folders: Iterable[Path] = (),
    group: str = hookspecs.ENTRY_POINT_GROUP,
    skip: Mapping[str, str] = MappingProxyType({}),
    before: Callable[[str], None] = lambda _: None,
) -> Catalogue:
    """Load every entry point of `group` and every `*.py` of `folders`; never raises for a broken one.

    `skip` maps names of plug-ins that are not to be loaded to the reason, which is listed as their error;
    `before` is called with each name before it is loaded.
    """
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    catalogue = Catalogue(provided={kind: {} for kind in _KIND_OF_HOOK.values()})
    for entry in sorted(importlib.metadata.entry_points(group=group), key=lambda e: e.name):
        dist = entry.dist
        name, version = (dist.name, dist.version) if dist else ("", "")
        load = partial(_guarded, entry.name, entry.load, skip, before)
        _load_one(manager, catalogue, entry.name, load, (name, version))
    for folder in folders:
        if not folder.is_dir():
            catalogue.plugins.append(
                PluginInfo(str(folder), "", "", 0, error=f"the plug-in folder {folder} does not exist")
            )
        for path in sorted(folder.glob("*.py")):
            load = partial(_guarded, path.stem, partial(_import_file, path), skip, before)
            _load_one(manager, catalogue, path.stem, load, (str(path), ""))
    return catalogue


def _guarded(name: str, load: Callable[[], Any], skip: Mapping[str, str], before: Callable[[str], None]) -> Any:
    if name in skip:
        raise PluginError(f"not loaded: {skip[name]}")
    before(name)
    return load()


def _load_one(
    manager: pluggy.PluginManager,
    catalogue: Catalogue,
    name: str,
    load: Callable[[], Any],
    source: tuple[str, str],
) -> None:
    version = source[1]
    api = 0
    try:
        module = load()
        version = version or str(getattr(module, "__version__", ""))
        api = int(getattr(module, "FRINGED_API_VERSION", hookspecs.API_VERSION))
        if api != hookspecs.API_VERSION:
            raise PluginError(f"it was made for plug-in API {api}; this is {hookspecs.API_VERSION}")
        manager.register(module, name)
        manager.check_pending()
        found = _collect(module)
        for kind, items in found.items():
            for item_name in items:
                if item_name in catalogue.provided[kind]:
                    raise PluginError(f"the {kind} {item_name!r} is already provided by another plug-in")
        for kind, items in found.items():
            catalogue.provided[kind].update(items)
        provides = {kind: tuple(sorted(items)) for kind, items in found.items() if items}
        catalogue.plugins.append(PluginInfo(name, source[0], version, api, provides))
    except (Exception, SystemExit) as error:  # noqa: BLE001  a plug-in may raise anything; it harms nobody else
        if manager.has_plugin(name):
            manager.unregister(name=name)
        text = "".join(traceback.format_exception(error, limit=-3)).strip()
        catalogue.plugins.append(PluginInfo(name, source[0], version, api, error=text))


def _collect(module: Any) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for hook, kind in _KIND_OF_HOOK.items():
        register = getattr(module, hook, None)
        found[kind] = {}
        for item in register() if register is not None else ():
            contract = _CONTRACT.get(kind)
            if contract is not None:
                _check_contract(kind, item, contract)
            found[kind][item.name] = item
    return found


def _check_contract(kind: str, item: Any, contract: Any) -> None:
    wanted = list(contract.__annotations__) + [
        n for n, v in vars(contract).items() if callable(v) and not n.startswith("_")
    ]
    missing = sorted({n for n in wanted if not hasattr(item, n)})
    if missing:
        raise PluginError(f"the {kind} {getattr(item, 'name', item)!r} lacks {', '.join(missing)}")


def _import_file(path: Path) -> Any:
    name = f"fringed_folder_plugin_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PluginError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
