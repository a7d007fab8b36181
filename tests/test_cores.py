"""Work side by side: the order of the items, as many threads as asked for, errors that reach the caller."""

import threading

import pytest

from twin.cores import cores, side_by_side


def test_results_come_in_the_order_of_the_items() -> None:
    assert side_by_side(lambda k: k * k, range(50)) == [k * k for k in range(50)]


def test_one_thread_where_the_environment_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert cores() == 1
    assert set(side_by_side(lambda _: threading.get_ident(), range(8))) == {threading.get_ident()}
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert cores() >= 1


def test_an_error_in_one_item_is_the_callers() -> None:
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda k: 1 / k, [2, 1, 0])
