"""Charts of how regions go on: dates that are the same in all of a series, and written as its length asks."""

import datetime
from dataclasses import replace

import numpy as np
from matplotlib.dates import num2date
from matplotlib.figure import Figure
from series_examples import series_of

from projects.model import Series
from reports.course_charts import draw_course, draw_dates

NAN = float("nan")


def draw(series: Series) -> tuple[list[str], list[datetime.date]]:
    """Return what stands below the chart of the only region, and the dates of its points."""
    axes = Figure(figsize=(2.6, 1.1)).add_subplot()
    draw_course(axes, series, series.regions.iloc[0])
    draw_dates(axes, series)
    axes.figure.draw_without_rendering()
    points = [x for line in axes.lines[1:] if line.get_marker() == "o" for x in np.atleast_1d(line.get_xdata())]
    first, last = axes.get_xlim()
    labels = [t.get_text() for t in axes.get_xticklabels() if first <= t.get_position()[0] <= last]
    return labels, [num2date(x).date() for x in points]


def test_charts_of_one_series_have_the_same_dates_however_many_epochs_know_the_region() -> None:
    """A region of one epoch had its own, and "2024 2025 2025 2025 2025" below it."""
    both, alone = (draw(series_of("steady", (-1e-4, mean))) for mean in (-4e-4, NAN))
    assert both[0] == alone[0] == ["2020", "2021", "2022", "2023", "2024"]
    assert both[1] == alone[1] == [datetime.date(2021, 1, 14), datetime.date(2024, 1, 15)]
    few = replace(series_of("steady", (-1e-4, -4e-4)), years=np.array([0.05, 0.4]))
    months = replace(few, history=few.history.assign(years=[0.05, 0.4]), dates=("2020-02-02", "2020-06-10"))
    assert draw(months)[0] == ["Feb 2020", "Mar 2020", "Apr 2020", "May 2020", "Jun 2020"]
    assert draw(months)[1] == [datetime.date(2020, 2, 2), datetime.date(2020, 6, 9)]


def test_the_title_of_a_course_that_is_open_has_room() -> None:
    series = series_of("accelerating or jump or onset or stopped", (-1e-4, -4e-4))
    axes = Figure().add_subplot()
    draw_course(axes, series, series.regions.iloc[0])
    assert axes.get_title(loc="left") == "region 1: the epochs do not tell its course"
