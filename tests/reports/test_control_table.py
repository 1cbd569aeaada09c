"""The report's table of targets and control points says how each fits, and is absent where there are none."""

from math import nan

from projects.model import Step
from reports.control import control_table


def network(residual: float, *, blunder: bool = False) -> list[Step]:
    def tie(name: str, scan: int, residual_m: list[float], is_blunder: bool = False) -> dict:
        return {"name": name, "scan": scan, "residual_m": residual_m, "is_blunder": is_blunder, "is_control": True}

    ties = [tie("P1", 0, [0.0, 0.0, 0.0001]), tie("P1", -1, [0.0, 0.6 * residual, 0.8 * residual])]
    ties += [tie("P2", -1, [nan, nan, nan], True)] if blunder else [tie("P2", -1, [0.0001, 0.0, 0.0])]
    figures = {"ties": ties, "n_targets": 1, "n_control": 2, "target_rms_m": 0.0001, "control_rms_m": residual,
               "sigma_position_m": 0.0004, "blunders": ["control point P2"] if blunder else []}  # fmt: skip
    return [Step("1", "network", automatic=figures)]


def test_each_control_point_has_its_residual_in_space() -> None:
    rows = {row[0]: row[1:] for row in control_table({"2024": network(0.002), "2025": network(0.003)}).rows}
    assert rows["Control point P1"] == ("2.0\u00a0mm", "3.0\u00a0mm")
    assert rows["Control point P2"] == ("0.10\u00a0mm", "0.10\u00a0mm")
    assert rows["Left out as blunders"] == ("none", "none")


def test_what_was_left_out_is_named_and_comes_first() -> None:
    table = control_table({"2024": network(0.002, blunder=True)})
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["Left out as blunders"] == "control point P2"
    assert rows["Control point P2"] == "left out"
    assert [row[0] for row in table.rows if row[0].startswith("Control point P")] == [
        "Control point P2", "Control point P1",
    ]  # fmt: skip


def test_no_table_without_targets() -> None:
    assert control_table({"2024": [Step("1", "network", automatic={"applied": True})], "2025": []}).rows == ()
