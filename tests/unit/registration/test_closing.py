"""From a chain to poses in which every overlap has its say: loops closed, lies refused, surfaces asked at last."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_relief import errors, head, pose, see

from fringed_plugins.registration.chaining import chain
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import rigid, rotation
from fringed_plugins.registration.views.closing import close_loops


@pytest.fixture(scope="module")
def seen():
    return [see(head, pose((0, angle, 0)), noise_mm=0.1, seed=k) for k, angle in enumerate((-20, 0, 20, 35))]


@pytest.fixture(scope="module")
def surfaces(seen):
    return [prepare(view.xyz_mm, name=f"view {k}") for k, view in enumerate(seen)]


@pytest.fixture(scope="module")
def linked(surfaces):
    return chain(surfaces)


@pytest.fixture(scope="module")
def known(linked):
    return {(link.partner, link.view): link.alignment for link in linked.links}


def worst(poses, seen):
    return max(errors(poses[k], seen[0], seen[k])[1] for k in range(1, len(seen)))


@pytest.mark.parametrize("refine", [False, True])
def test_views_of_a_head_close_their_loops(surfaces, linked, known, seen, refine):
    heard = []
    found = close_loops(surfaces, linked.T_model_view, known, report=lambda part, _: heard.append(part), refine=refine)
    assert len(found.edges) == 6 and not found.graph.dropped
    assert heard[-1] == 1.0 and all(0 <= part <= 1 for part in heard)
    assert np.array_equal(found.T_model_view[0], np.eye(4))
    assert worst(found.T_model_view, seen) < 0.02
    assert (found.joint is not None) == refine
    if not refine:
        assert found.after[1] <= found.before[1]


def test_pair_that_lies_is_refused_and_the_rest_is_right(surfaces, linked, known, seen):
    honest = close_loops(surfaces, linked.T_model_view, known, refine=False)
    wrong = {(e.i, e.j): replace(known.get((e.i, e.j), known[0, 1]), T_reference_model=e.T_i_j, covariance=e.covariance)
             for e in honest.edges}  # fmt: skip
    lie = rigid(rotation([0.0, 0.2, 0.0]), [3.0, 0.0, 0.0])
    wrong[0, 2] = replace(wrong[0, 2], T_reference_model=lie @ wrong[0, 2].T_reference_model)
    found = close_loops(surfaces, linked.T_model_view, wrong, refine=False)
    assert [found.edges[out.edge].name for out in found.graph.dropped] == ["1-3"]
    assert worst(found.T_model_view, seen) < 0.03


def test_pair_without_a_covariance_is_registered_again(surfaces, linked, known):
    bare = {pair: replace(found, covariance=None) for pair, found in known.items()}
    found = close_loops(surfaces, linked.T_model_view, bare, refine=False)
    assert all(edge.covariance is not None for edge in found.edges) and len(found.edges) == 6


def test_views_that_meet_nobody_stay_where_the_chain_put_them(surfaces, linked, known):
    """Of four views only the first two are asked: the poses of the others are nobody's to change."""
    two = {view: linked.T_model_view[view] for view in (0, 1)}
    found = close_loops(surfaces, two, {(0, 1): known[0, 1]}, refine=False)
    assert set(found.T_model_view) == {0, 1} and len(found.edges) == 1


def test_cancelling_is_heard(surfaces, linked, known):
    def stop(part, text):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        close_loops(surfaces, linked.T_model_view, known, report=stop)
