"""The processor `register`: one pair of views."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from fringed.data import Mesh, Model, RangeImage, Registration
from fringed.errors import DataError, UsageError
from fringed.hookspecs import Context
from fringed_plugins.registrars.common import MM, PairParams, Row, product_of, report_to, scan_of
from fringed_plugins.registration.family.pair import register_by
from fringed_plugins.registration.family.presets import METHODS
from fringed_plugins.registration.guesses import GUESSERS
from fringed_plugins.registration.register import register


class Register:
    """Bring one view to another's frame: by the default method, or by one of the literature, verified."""

    name: ClassVar[str] = "register"
    version: ClassVar[str] = "3.0.0"
    summary: ClassVar[str] = "views brought together from anywhere, foot to foot, verified; or by a named method"
    inputs: ClassVar[Mapping[str, Any]] = {
        "reference": RangeImage | Model | Mesh,
        "model": RangeImage | Model | Mesh,
    }
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Registration

    class Params(PairParams, frozen=True, kw_only=True):
        """Parameters of `register`."""

        method: Annotated[str, Meta(description="`default`, or a method of the literature: " + ", ".join(METHODS))] = (
            "default"
        )
        search: Annotated[
            str,
            Meta(
                description="guesses that follow a refuted start, default method only: `auto`, `none`, or those of "
                + ", ".join(GUESSERS)
            ),
        ] = "auto"
        T_reference_model: Annotated[
            tuple[Row, Row, Row, Row] | None,
            Meta(description="start as four rows of four numbers; null: find one", extra_json_schema=MM),
        ] = None

    def run(self, inputs: Mapping[str, Any], params: Any, context: Context) -> Registration:
        """Return the registration, `converged` or not with its reason.

        Raises
        ------
        DataError
            views that cannot be registered, or a start that is not rigid.
        UsageError
            a method or a search that there is not, or both of them.
        """
        reference, model = inputs["reference"], inputs["model"]
        search = _named("search", params.search, ("auto", "none", *GUESSERS))
        wish = params.options(context.threads, params.T_reference_model)
        options = replace(wish, search="" if search == "none" else search)
        if params.method != "default" and search != "auto":
            raise UsageError(
                f"search = {search!r} with method = {params.method!r}: methods of the literature start where they are "
                "told, or as the views stand; leave `search` out, or take the default method"
            )
        method = METHODS.get(_named("registration method", params.method, ("default", *METHODS)))
        report = report_to(context)
        try:
            context.progress(0.0, "preparing the reference")
            fixed = scan_of(reference, "reference", context.threads, report)
            context.progress(0.0, "preparing the model")
            moving = scan_of(model, "model", context.threads, report)
            if method is None:
                alignment = register(fixed, moving, options, report)
            else:
                alignment = register_by(method, fixed, moving, options, params.iterations or None, report)
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"cannot register: {error}") from error
        if not alignment.converged:
            context.log("warning", f"the registration did not converge: {alignment.reason}")
        return product_of(alignment, reference.id, model.id)


def _named(what: str, name: str, known: Sequence[str]) -> str:
    """Return a name that there is; raise UsageError with those that look like it."""
    if name in known:
        return name
    close = difflib.get_close_matches(name, known, 3)
    meant = f"did you mean {' or '.join(close)}? " if close else ""
    raise UsageError(f"no {what} is called {name!r}; {meant}There are {', '.join(known)}")
