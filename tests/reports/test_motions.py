"""How the object as a whole goes on moving, in words and tables: only what the epochs bear out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from series_examples import series_of

from projects.model import CLOSURE_COLUMNS, MOTION_COLUMNS, Series
from reports.courses import tell_series
from reports.motions import steady_motion_table, tell_motions

SURE = {"p_rate": 1e-9, "p_turn": 0.7, "p_shift": 1e-9, "p_fit": 0.4}


def moving(rate: tuple[float, ...] = (0.0, 1e-5, 0.0, 3e-5, 0.0, -1.02e-3), **given: Any) -> Series:
    """Return a series of a whole that moves at a rate, known to 0.04 mm and 0.0001 rad a year."""
    covariance = np.diag([1e-4] * 3 + [4e-5] * 3) ** 2
    steady = {"centre": [1.0, 2.0, 3.0], "epochs": 3, "rate": list(rate), "covariance": covariance.tolist(), **SURE}
    motions = [[e, t, 1e-3 * t, 4e-5, 1e-5, 1e-4, 1e-9, 0, 0, 0, 0, 0, 0] for e, t in (("b", 1.0), ("c", 4.0))]
    return replace(
        series_of("steady", (-1e-4, -4e-4)), statistics={"steady_motion": steady | given},
        motions=pd.DataFrame(motions, columns=list(MOTION_COLUMNS)),
        closures=pd.DataFrame([["a", "b", 0.4]], columns=list(CLOSURE_COLUMNS)),
    )  # fmt: skip


def said(series: Series) -> str:
    return tell_series(series).lead.replace("\u00a0", " ")


def test_a_whole_that_settles_says_by_how_much_a_year_and_which_way() -> None:
    assert said(moving()).endswith(
        " As a whole it moves on steadily: it is displaced by 1.02 ± 0.08 mm downwards a year."
    )
    up = moving((0.0, 1e-3, 0.0, 3e-5, 0.0, 1.02e-3), p_turn=1e-4)
    assert said(up).endswith("by 1.02 ± 0.08 mm upwards and turns by 0.057° ± 0.011° a year.")
    aside = moving((0.0, 0.0, 0.0, 8e-4, 0.0, -6e-4))
    assert said(aside).endswith("by 1.00 ± 0.08 mm a year.")
    leaning = moving((0.0, 1e-3, 0.0, 3e-5, 0.0, 0.0), p_turn=1e-4, p_shift=0.6)
    assert said(leaning).endswith("steadily: it turns by 0.057° ± 0.011° a year.")


def test_a_whole_that_jumped_or_rests_gets_no_rate() -> None:
    assert said(moving(p_fit=0.009)).endswith(" As a whole it moved, but at no one rate.")
    rests = moving((0.0, 1e-4, 0.0, 0.0, 0.0, 5e-5), p_rate=0.4, p_turn=0.3, p_shift=0.4)
    assert said(rests).endswith(" No steady motion of the whole is told: 0.05 ± 0.08 mm and 0.006° ± 0.011° a year.")
    unknown = replace(moving(), statistics={})  # of frames of which nothing is known
    assert said(unknown) == said(series_of("steady", (-1e-4, -4e-4)))


@pytest.mark.parametrize(("given", "word"), [({}, "steady"), ({"p_fit": 0.001}, "at no one rate"),
                                             ({"p_rate": 0.06}, "not significant")])  # fmt: skip
def test_the_table_of_motions_ends_with_those_of_a_year(given: dict[str, float], word: str) -> None:
    table = tell_motions(moving(**given))
    assert table is not None
    assert [row[0] for row in table.rows] == ["b", "c", "a year"]
    assert [text.replace("\u00a0", " ") for text in table.rows[-1][1:]] == ["1.02 ± 0.08 mm", "0.001° ± 0.011°", word]
    older = tell_motions(replace(moving(), statistics={}))
    assert older is not None
    assert [row[0] for row in older.rows] == ["b", "c"]


def test_the_row_for_files_has_rates_and_sigmas_of_all_axes() -> None:
    table = steady_motion_table(moving())
    assert table is not None
    row = table.iloc[0]
    assert [row[a] for a in "xyz"] == [1.0, 2.0, 3.0]
    assert row["z_m_per_year"] == pytest.approx(-1.02e-3)
    assert row["sigma_z_m_per_year"] == pytest.approx(4e-5)
    assert row["turn_y_rad_per_year"] == pytest.approx(1e-5)
    assert row["sigma_turn_y_rad_per_year"] == pytest.approx(1e-4)
    assert row["p_fit"] == 0.4
    assert steady_motion_table(series_of("steady", (-1e-4, -4e-4))) is None


def test_registrations_that_close_no_loop_are_not_said_to_fit_each_other() -> None:
    """Two links to two epochs fit whatever they say: "off by 0.0 sigma" had been told."""
    series = moving()
    links = [["a", epoch, 0.0] for epoch in series.motions["epoch"]]
    table = tell_motions(replace(series, closures=pd.DataFrame(links, columns=list(CLOSURE_COLUMNS))))
    held = [*links, ["b", "d", float("nan")]]  # by frames alone: it fits nothing worse than all others
    assert tell_motions(replace(series, closures=pd.DataFrame(held, columns=list(CLOSURE_COLUMNS)))) == table
    assert table is not None
    assert "No registration between two later epochs checks them." in table.note
    assert "sigma" not in table.note
