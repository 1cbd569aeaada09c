"""Charts of how regions go on: dates that are the same in all of a series, and written as its length asks."""

import datetime
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import num2date
from matplotlib.figure import Figure
from report_examples import facts_of
from series_examples import series_of

from projects.model import Series
from reports import course_charts
from reports.captions import write_captions
from reports.course_charts import draw_course, draw_courses, draw_dates

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


def test_every_date_stands_once_below_a_chart_and_with_its_year() -> None:
    """Two days apart "01 Feb 01 Feb 02 Feb" stood there."""
    series = series_of("steady", (-1e-4, -4e-4))
    days = replace(series, reference_date="2003-02-01", years=np.array([1.0, 2.0]) / 365.25)
    days = replace(days, history=days.history.assign(years=days.years))
    assert draw(days)[0] == ["01 Feb\n2003", "02 Feb\n2003", "03 Feb\n2003"]
    weeks = replace(days, years=10.0 * days.years, history=days.history.assign(years=10.0 * days.years))
    labels = draw(weeks)[0]
    assert len(set(labels)) == len(labels) >= 2
    assert all(label.endswith("\n2003") for label in labels)


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_the_title_of_an_axis_stands_within_the_picture_however_long_its_numbers(scale, monkeypatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(course_charts, "write_svg", lambda figure: drawn.append(figure) or b"")
    series = series_of("steady", (-1.2e-4 * scale, -4e-4 * scale))
    rows, history = series.regions, series.history
    draw_courses(replace(series, regions=pd.concat([rows, rows.assign(identity=2)]),
                         history=pd.concat([history, history.assign(identity=2)])))  # fmt: skip
    renderer = FigureCanvasAgg(drawn[0]).get_renderer()
    left, right = (axes.get_tightbbox(renderer) for axes in drawn[0].axes)
    assert left.x0 > 0.0
    assert left.x1 < right.x0
    assert right.x1 < drawn[0].get_figwidth() * drawn[0].dpi
    numbers = [t.get_text() for t in drawn[0].axes[0].get_yticklabels() if t.get_text() != "0"]
    assert len({len(text.partition(".")[2]) for text in numbers}) == 1


def test_the_title_of_a_course_that_is_open_has_room() -> None:
    series = series_of("accelerating or jump or onset or stopped", (-1e-4, -4e-4))
    axes = Figure().add_subplot()
    draw_course(axes, series, series.regions.iloc[0])
    assert axes.get_title(loc="left") == "region 1: the epochs do not tell its course"


def test_the_legend_is_true_of_a_hollow_point_whose_bar_does_not_reach_zero() -> None:
    """It was called not significant."""
    series = series_of("steady", (-1e-3, -4e-3))
    history = series.history.assign(region=[0, 1], sigma_mean_m=1e-4)
    axes = Figure(figsize=(2.6, 1.1)).add_subplot()
    draw_course(axes, replace(series, history=history), series.regions.iloc[0])
    (hollow,) = [line for line in axes.lines if str(line.get_markerfacecolor()) == "white"]
    at = np.atleast_1d(hollow.get_xdata())[0]
    (bar,) = [bar for bar in axes.collections[0].get_segments() if bar[0, 0] == at]
    assert bar[:, 1].max() < 0.0
    told = write_captions(facts_of()).courses
    assert "not significant" not in told
    assert "hollow: measured at the same place where none was found" in told
    assert "Where the bar of a hollow one does not reach zero, this place taken by itself differs in that epoch" in told
