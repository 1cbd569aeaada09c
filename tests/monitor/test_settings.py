"""Settings: the TOML that is printed is the TOML that is read, and a wrong line is refused with what to do."""

import itertools
import tomllib
from pathlib import Path

import numpy as np
import pytest

from monitor.declare import given_or_default
from monitor.filtering import SilhouetteSettings
from monitor.reconstruction import SurfaceSettings, reconstruct
from monitor.settings import Settings, read_settings, to_toml
from projects.errors import ParameterError
from projects.model import PointCloud


def test_printed_settings_read_back_to_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "all.toml"
    path.write_text(to_toml())
    assert read_settings(path) == Settings()


def test_every_setting_says_unit_or_meaning_above_it() -> None:
    lines = to_toml().splitlines()
    for above, line in itertools.pairwise(lines):
        if "=" in line and not line.startswith("#"):
            assert above.startswith("# ")
            assert len(above) > 20, f"{line} has no meaning"


def test_a_changed_setting_changes_only_itself(tmp_path: Path) -> None:
    table = tomllib.loads(to_toml())
    group = next(name for name in table if any(isinstance(v, float) for v in table[name].values()))
    name, value = next((n, v) for n, v in table[group].items() if isinstance(v, float))
    path = tmp_path / "one.toml"
    path.write_text(f"[{group}]\n{name} = {value * 1.01!r}\n")
    changed = read_settings(path)
    assert getattr(getattr(changed, group), name) == value * 1.01
    assert getattr(Settings(), group) != getattr(changed, group)
    others = [g for g in table if g != group]
    assert all(getattr(changed, g) == getattr(Settings(), g) for g in others)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[icp]\nmax_iteration = 3\n", "did you mean max_iterations"),
        ("[nothing]\nx = 1\n", "there is no setting nothing"),
        ("icp = 3\n", "a group of settings"),
        ("[icp\n", "not valid TOML"),
        ("[icp]\nmax_iterations = 'many'\n", "a value like"),
        ("[filter.averaging]\nenabled = 'auto'\n", "enabled cannot be auto; its default is true$"),
        ("[filter.silhouettes]\ndrop_rims = 1\n", "drop_rims = 1: a value like true is needed$"),
        ("[filter.thinning]\ntarget_spacing = [0.004]\n", r"target_spacing = \[0.004\]: a number is needed$"),
        (
            "[filter.thinning]\ntarget_spacing = '4 mm'\n",
            r"toml: \[filter\]: \[thinning\]: .*target_spacing = '4 mm': a number",
        ),
        ("[filter.thinning]\ntarget_spacing = nan\n", "target_spacing = nan m: allowed is 1e-06 to 10.0"),
        ("[compare]\nsearch_limit = -1\n", "search_limit = -1 m: allowed is at least 1e-06$"),
        ("[compare]\nlargest_lod95 = 0\n", "largest_lod95 = 0 m: allowed is at least 1e-06$"),
        ("[compare]\nfalse_discovery_rate = 2\n", "false_discovery_rate = 2.0: allowed is 1e-09 to 0.5"),
        ("[filter.normals]\nn_neighbours = 12.5\n", "n_neighbours = 12.5: a whole number is needed"),
        ("[filter.diffusion]\nn_steps = true\n", "n_steps = True: a whole number is needed"),
        ("[compare]\nsearch_limit = inf\n", "search_limit = inf m: allowed is at least 1e-06, and finite$"),
        ("[icp]\nprecision = inf\n", "precision = inf m: allowed is at least 0.0, and finite$"),
        ("[targets]\nsmallest_board = 0.5\n", "smallest_board = 0.5 exceeds largest_board = 0.4; set a smaller one"),
        (f"x = {'[' * 5000}{']' * 5000}\n", "wrong.toml: is nested too deeply for settings$"),
    ],
)
def test_wrong_lines_are_refused_with_what_to_do(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=message):
        read_settings(path)


def test_a_missing_file_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cannot be read"):
        read_settings(tmp_path / "none.toml")


def test_a_word_is_no_switch() -> None:
    """A word is true to Python, "no" too."""
    with pytest.raises(ParameterError, match="drop_rims = 'no': allowed are true and false"):
        SilhouetteSettings(drop_rims="no")


@pytest.mark.parametrize("given", [{"cell_size": 0.001}, "fast", 3])
def test_settings_of_another_kind_are_refused_with_what_is_needed(given: object) -> None:
    with pytest.raises(ParameterError, match=r"a (dict|str|int) was given; a SurfaceSettings is needed, as Surface"):
        given_or_default(given, SurfaceSettings)
    assert given_or_default(None, SurfaceSettings) == SurfaceSettings()
    assert given_or_default(SurfaceSettings(cell_size=0.002), SurfaceSettings).cell_size == 0.002


def test_a_reconstruction_by_a_dict_of_settings_is_refused() -> None:
    with pytest.raises(ParameterError, match="a SurfaceSettings is needed"):
        reconstruct(PointCloud(np.eye(3)), {"cell_size": 0.001})  # type: ignore[arg-type]
