"""Series of the example of reports: one followed region, or those of its comparison."""

import dataclasses

import numpy as np
import pandas as pd
from report_examples import DENT, PATCH, column, example_comparison

from projects.model import FORECAST_COLUMNS, HISTORY_COLUMNS, SERIES_COLUMNS, Series

NAN = float("nan")


def series_of(model: str, means: tuple[float, float]) -> Series:
    """Return three epochs, a to c, and one region that lost material; `means` [m] are of b and c."""
    row = dict.fromkeys(SERIES_COLUMNS, 0.0) | {"identity": 1, "first_seen": "b", "last_seen": "b", "area_m2": 0.002,
                                                "model": model, "rate_m_per_year": -1e-4, "onset_to_years": 1.0,
                                                "sigma_rate_m_per_year": 1e-6}  # fmt: skip
    history = [
        [1, epoch, years, 1, "", mean, 1e-5 if np.isfinite(mean) else NAN, NAN, NAN, NAN, NAN]
        for epoch, years, mean in zip("bc", (1.0, 4.0), means, strict=True)
    ]
    empty = np.empty(0)
    return Series(
        "a", "2020-01-15", ("b", "c"), ("2021-01-15", "2024-01-15"), np.array([1.0, 4.0]), empty, empty, empty, empty,
        np.empty(0, dtype=np.int32), pd.DataFrame([row]), pd.DataFrame(history, columns=list(HISTORY_COLUMNS)),
        pd.DataFrame(columns=list(FORECAST_COLUMNS)),
    )  # fmt: skip


def followed(numbers: dict[int, int]) -> Series:
    """Return a series of the column whose regions, by their numbers, are these of the comparison (0: on the back)."""
    on_reference = example_comparison().on_reference
    angle, up, _ = column()
    behind = (np.abs(angle - np.pi / 2) < 0.2) & (np.abs(up - 0.5) < 0.05)
    identity = np.zeros(len(angle), np.int32)
    for number, region in numbers.items():
        identity[behind if region == 0 else (on_reference.region == region) & (identity == 0)] = number
    series = series_of("jump", (-3e-4, -4e-4))
    (row,), places = series.regions.to_dict("records"), {0: (0.0, 0.2, 0.5), 1: DENT[-3:], 2: PATCH[-3:]}
    rows = [row | {"identity": k} | dict(zip("xyz", places[r], strict=True)) for k, r in numbers.items()]
    history = [[k, "c", 4.0, r, "", -4e-4, 1e-5, np.nan, np.nan, np.nan, np.nan] for k, r in numbers.items()]
    return dataclasses.replace(
        series, identity=identity, rate=np.zeros(len(angle)), sigma_rate=np.ones(len(angle)),
        acceleration=np.zeros(len(angle)), sigma_acceleration=np.ones(len(angle)), regions=pd.DataFrame(rows),
        history=pd.DataFrame(history, columns=list(HISTORY_COLUMNS)),
    )  # fmt: skip
