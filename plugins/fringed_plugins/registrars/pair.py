"""The processor `register`: one pair of views."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from fringed.data import RangeImage, Registration
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.registrars.common import MM, PairParams, Row, product_of, report_to, surface_of
from fringed_plugins.registration.family.method import Method
from fringed_plugins.registration.family.pair import register_by
from fringed_plugins.registration.family.presets import METHODS
from fringed_plugins.registration.register import register


class Register:
    """Bring one range image to another's frame: by the default method, or by one of the literature, verified."""

    name: ClassVar[str] = "register"
    version: ClassVar[str] = "2.0.0"
    summary: ClassVar[str] = "views brought together from anywhere, foot to foot, verified; or by a named method"
    inputs: ClassVar[Mapping[str, Any]] = {"reference": RangeImage, "model": RangeImage}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Registration

    class Params(PairParams, frozen=True, kw_only=True):
        """Parameters of `register`."""

        method: Annotated[str, Meta(description="`default`, or a method of the literature: " + ", ".join(METHODS))] = (
            "default"
        )
        search: Annotated[
            bool, Meta(description="whether a refuted start is followed by guesses (default method only)")
        ] = True
        T_reference_model: Annotated[
            tuple[Row, Row, Row, Row] | None,
            Meta(description="start as four rows of four numbers; null: find one", extra_json_schema=MM),
        ] = None

    def run(self, inputs: Mapping[str, Any], params: Any, context: Context) -> Registration:
        """Return the registration, `converged` or not with its reason.

        Raises
        ------
        DataError
            range images that cannot be registered, or a start that is not rigid.
        """
        reference, model = inputs["reference"], inputs["model"]
        options = replace(params.options(context.threads, params.T_reference_model), search=params.search)
        method = _method(params.method)
        try:
            context.progress(0.0, "preparing the reference")
            fixed = surface_of(reference, "reference")
            context.progress(0.0, "preparing the model")
            moving = surface_of(model, "model")
            if method is None:
                alignment = register(fixed, moving, options, report_to(context))
            else:
                alignment = register_by(method, fixed, moving, options, params.iterations or None, report_to(context))
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"cannot register: {error}") from error
        if not alignment.converged:
            context.log("warning", f"the registration did not converge: {alignment.reason}")
        return product_of(alignment, reference.id, model.id)


def _method(name: str) -> Method | None:
    """Return the method of the literature that is meant, None for the default one."""
    if name == "default":
        return None
    if name not in METHODS:
        close = difflib.get_close_matches(name, [*METHODS, "default"], 3)
        meant = f"did you mean {' or '.join(close)}? " if close else ""
        raise DataError(f"no registration method is called {name!r}; {meant}There are default, {', '.join(METHODS)}")
    return METHODS[name]
