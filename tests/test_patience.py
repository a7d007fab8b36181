"""A search that is out of time leaves things out and says which."""

from types import SimpleNamespace

import numpy as np

from twin.diagnose.decide import Decision, half_unnamed
from twin.diagnose.patience import LEAST_MIN, Patience, usual_minutes
from twin.diagnose.search import FURTHER, given_up
from twin.diagnose.verdict import judge


def test_nothing_is_left_out_in_time() -> None:
    patience = Patience()
    assert not patience.over("further effects")
    assert patience.notes() == []


def test_what_is_left_out_is_said_once() -> None:
    patience = Patience(0.0)
    assert patience.over("further effects")
    assert patience.over("further effects")
    assert patience.over("wider bands")
    (note,) = patience.notes()
    assert note.kind == "search_ended"
    assert "further effects; wider bands" in note
    assert note.count("further effects") == 1


def test_a_large_recording_is_given_more() -> None:
    def test(values: int) -> float:
        posture = SimpleNamespace(frf=np.broadcast_to(0j, (values,)), q_deg=(0.0,) * 6)
        content = SimpleNamespace(postures={"a": posture})
        return usual_minutes(SimpleNamespace(kind="frf-campaign", content=content))  # type: ignore[arg-type]

    assert test(1000) == LEAST_MIN
    assert test(3_000_000) > 2 * LEAST_MIN


def test_what_was_not_tried_is_as_likely_as_what_was() -> None:
    decision = half_unnamed(Decision([SimpleNamespace()], [0.99], 0.0, 0.01, alike=0.99))  # type: ignore[list-item]
    assert decision.probability == [0.495]
    assert judge(decision) == "unexplained"


def test_only_a_fit_that_further_effects_may_explain_is_given_up() -> None:
    """Where every round was made, a fit that misses by little keeps its name though the time is up."""
    search = SimpleNamespace(patience=Patience(0.0))
    close, far = (SimpleNamespace(misfit=misfit, data=1e5) for misfit in (1.2, 100.0))
    assert not given_up(search, close)  # type: ignore[arg-type]
    assert given_up(search, far)  # type: ignore[arg-type]
    search.patience.over(FURTHER)
    assert given_up(search, close)  # type: ignore[arg-type]
    assert not given_up(SimpleNamespace(patience=Patience()), far)  # type: ignore[arg-type]
