"""What stable areas say of the size of errors: what is stated is scaled, in each stratum; what is not gets a floor."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from monitor.comparison.distances.side import class_of_stated, thirds_of
from monitor.comparison.noise import model as noise_module
from monitor.comparison.noise.asked_scale import asked_scale, believe
from monitor.comparison.noise.calm_vertices import CalmVertices, n_held, sort_by_stratum
from monitor.comparison.noise.correlation import Correlation, spherical
from monitor.comparison.noise.error_parts import Parts
from monitor.comparison.noise.model import Noise, count_witnesses, learn_sizes
from monitor.comparison.noise.strata import EVERY, KINDS, N_STRATA, SHAPE, stratum_of
from projects.model import Floats, Ints


def test_witnesses_of_a_variance_are_those_that_its_scatter_shows(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0.0, 1.0, (300, 2)), np.zeros(300)])
    correlation = Correlation(np.array([0.6]), np.array([0.4]))
    lag = cdist(points, points)
    rho = np.where(lag > 0.0, 0.6 * spherical(lag / 0.4), 1.0)
    errors = np.linalg.cholesky(rho) @ rng.normal(size=(300, 4000))
    scatter2 = np.var(np.mean(errors**2, axis=0))  # 2 / n of n independent ones
    assert count_witnesses(points, 300, correlation) == pytest.approx(2.0 / scatter2, rel=0.1)  # of means: a quarter


def asked_of(distances: Floats, own: Floats, motion: Floats) -> float:
    """Return the scale that vertices of one stratum ask for."""
    none, place = np.zeros(len(own)), np.full(len(own), 3)
    places = np.arange(len(own))
    calm = CalmVertices(np.zeros((0, 3)), places, distances, own, none, none, motion, place,
                        *sort_by_stratum(places, place), 0.0)  # fmt: skip
    return asked_scale([calm], np.array([3]), np.ones(N_STRATA), 0.95)


def test_the_registration_stays_as_stated_while_the_rest_is_scaled(rng: np.random.Generator) -> None:
    own, motion = rng.uniform(0.001, 0.002, 50_000), np.full(50_000, 0.0006)
    distances = np.hypot(0.5 * own, motion) * rng.normal(size=50_000)
    assert asked_of(distances, own, motion) == pytest.approx(0.5, rel=0.02)  # 0.6 if both are scaled


def test_the_registration_makes_up_for_half_of_what_is_seen_at_most(rng: np.random.Generator) -> None:
    own, motion = np.full(50_000, 0.001), np.full(50_000, 0.002)
    distances = 0.1 * np.hypot(own, motion) * rng.normal(size=50_000)  # the motion was fitted to them
    assert asked_of(distances, own, motion) == pytest.approx(0.1 * np.sqrt(0.5), rel=0.02)


def test_as_many_witnesses_as_hold_it_are_believed_half() -> None:
    assert believe(0.25, 2.0, 2.0) == pytest.approx(0.5)  # half of the logarithm
    assert believe(0.25, 1e6, 2.0) == pytest.approx(0.25, rel=1e-4)
    assert believe(4.0, 2.0, 2.0) == pytest.approx(2.0)
    assert believe(4.0, 4.0, 12.0) == pytest.approx(np.sqrt(2.0))


def place(rim: int, rough: int, view: int = 0, gap: int = 0, stated: int = 0, arm: int = 0) -> int:
    """Return the stratum of these classes."""
    return int(EVERY.reshape(SHAPE)[rim, rough, view, gap, stated, arm])


def calm_of(
    rng: np.random.Generator, true: Floats, stratum: Ints, motion: float = 0.0, shared: Floats | None = None
) -> CalmVertices:
    """Return vertices far from each other, stated as 1 mm, whose errors are `true` [mm] in their stratum; `shared`
    [mm] is what scans are said to disagree by, and hold no error of."""
    n = len(stratum)
    distances = 1e-3 * np.hypot(true[stratum], motion) * rng.normal(size=n)
    points = np.column_stack([np.arange(n), np.zeros((n, 2))])
    none, moved = np.zeros(n), np.full(n, 1e-3 * motion)
    disagree = none if shared is None else 1e-3 * shared
    return CalmVertices(points, np.arange(n), distances, np.full(n, 1e-3), none, disagree, moved, stratum,
                        *sort_by_stratum(np.arange(n), stratum), 1e-12)  # fmt: skip


NO_AGREEMENT = Correlation(np.array([0.5]), np.array([0.1]))
SMOOTH, MEDIUM, ROUGH = place(4, 0), place(4, 1), place(4, 2)


def learn(calm: list[CalmVertices], rng: np.random.Generator) -> tuple[float, Floats]:
    """Return the floor [m], and the scale of what is stated in each stratum."""
    parts, factors = learn_sizes(calm, 0.95, NO_AGREEMENT, rng)
    return parts.floor, parts.surfaces * factors


def test_each_class_exceeds_its_level_in_one_vertex_of_twenty(rng: np.random.Generator) -> None:
    true = np.full(N_STRATA, 0.6)  # rough places err more beside what is stated of them
    true[[SMOOTH, ROUGH]] = 0.54, 0.96
    stratum = np.repeat([SMOOTH, MEDIUM, ROUGH], (4000, 2000, 200))
    calm = [calm_of(rng, true, stratum, 0.2) for _ in range(2)]
    floor, scales = learn(calm, rng)
    scales = np.hypot(scales, 1e3 * floor * scales / scales[SMOOTH])
    assert scales[[SMOOTH, MEDIUM]] == pytest.approx(true[[SMOOTH, MEDIUM]], rel=0.05)
    assert scales[ROUGH] == pytest.approx(true[ROUGH], rel=0.2)  # of 400, whose quantile is known to a twentieth
    level = 1.96 * np.hypot(scales[stratum] * 1e-3, 0.2e-3)
    beyond = np.mean([np.abs(c.distances) > level for c in calm], axis=0)
    assert beyond.mean() == pytest.approx(0.05, abs=0.002)
    shares = [beyond[stratum == k].mean() for k in (SMOOTH, MEDIUM, ROUGH)]
    assert shares[:2] == pytest.approx([0.05, 0.05], abs=0.004)
    assert shares[2] == pytest.approx(0.05, abs=0.025)  # 0.25 with the scale of all


@pytest.mark.parametrize("kind", ["view", "gap", "arm"])
def test_what_was_seen_badly_has_a_level_of_its_own(kind: str, rng: np.random.Generator) -> None:
    good, bad = place(4, 0), place(4, 0, **{kind: 2})
    true = np.ones(N_STRATA)
    true[bad] = 2.0
    _, scales = learn([calm_of(rng, true, np.repeat([good, bad], (3000, 300)))] * 2, rng)
    assert scales[bad] / scales[good] == pytest.approx(2.0, rel=0.12)  # of 300 independent ones
    rough = place(4, 1, **{kind: 2})  # no witness: what smooth places show
    assert scales[rough] / scales[bad] == pytest.approx(scales[place(4, 1)] / scales[good], rel=1e-9)


def test_a_stratum_of_few_witnesses_goes_with_its_class(rng: np.random.Generator) -> None:
    few = place(0, 2)
    true = np.ones(N_STRATA)
    true[[few, ROUGH]] = 2.0
    stratum = np.r_[np.repeat([SMOOTH, ROUGH], (3000, 1000)), few, few, few, few]
    _, scales = learn([calm_of(rng, true, stratum)] * 2, rng)
    assert scales[few] == pytest.approx(scales[ROUGH], rel=0.01)
    assert scales[ROUGH] / scales[SMOOTH] == pytest.approx(2.0, rel=0.1)


def test_the_first_look_that_knows_of_no_witness_takes_what_is_stated(rng: np.random.Generator) -> None:
    calm = [calm_of(rng, np.full(N_STRATA, 0.5), np.full(5000, SMOOTH))] * 2
    parts, factors = learn_sizes(calm, 0.6827, None, rng)
    assert parts == (1.0, 1.0, 1.0, 0.0)
    assert (factors == 1.0).all()
    wide = [calm_of(rng, np.full(N_STRATA, np.hypot(1.0, 3.0)), np.full(5000, SMOOTH))] * 2
    assert learn_sizes(wide, 0.6827, None, rng)[0] == (1.0, 1.0, 1.0, pytest.approx(0.003, rel=0.05))


def test_what_nothing_states_is_a_floor(rng: np.random.Generator) -> None:
    calm = calm_of(rng, np.full(N_STRATA, 3.0), np.full(50_000, SMOOTH))
    calm = calm._replace(own=np.zeros(len(calm.own)))
    parts, factors = learn_sizes([calm] * 2, 0.95, NO_AGREEMENT, rng)
    assert parts.floor * factors[SMOOTH] == pytest.approx(0.003, rel=0.02)


def test_strata_are_told_by_rim_roughness_view_gap_what_is_stated_and_arm() -> None:
    classes = {"view": [0, 3, 0], "gap": [0, 2, 1], "stated": [0, 1, 0], "arm": [0, 1, 2]}
    surface = SimpleNamespace(roughness=np.array([0, 2, 1]))
    side = SimpleNamespace(surface=surface, to_rim=np.array([np.nan, 0.003, 0.1]),
                           **{kind: np.array(c, dtype=np.uint8) for kind, c in classes.items()})  # fmt: skip
    assert stratum_of(side, 0.001).tolist() == [place(4, 0), place(1, 2, 3, 2, 1, 1), place(4, 1, 0, 1, 0, 2)]
    assert sorted(np.concatenate(KINDS["view"])) == list(range(N_STRATA))


def test_a_test_of_patches_takes_the_thirds_of_the_arm_as_one() -> None:
    scales = np.ones(N_STRATA)
    scales[place(4, 0, arm=2)] = 3.0
    noise = Noise(0.1 * scales, scales, scales, scales, NO_AGREEMENT, 0.001)
    best = np.zeros(2, dtype=np.uint8)
    surface = SimpleNamespace(roughness=np.array([0, 1]))
    sigmas = {"sigma_surfaces": np.full(2, 0.5), "sigma_discord": np.full(2, 0.2)}
    side = SimpleNamespace(surface=surface, other=surface, foot_vertices=np.arange(2), to_rim=np.full(2, np.nan),
                           view=best, gap=best, stated=best, arm=best, **sigmas)  # fmt: skip
    assert noise.variance_of(side) == pytest.approx([1.1, 0.3])  # (1 + 1 + 9) / 3, of 0.5^2 + 0.2^2 + 0.1^2


def test_a_class_of_its_own_where_more_is_stated_than_four_times_the_usual() -> None:
    stated, is_assessed = np.array([1.0, 1.0, 3.9, 4.1, np.nan, 9.0]), np.array([True, True, True, True, False, False])
    usual_is_one = np.append(stated, np.ones(5))
    told = class_of_stated(usual_is_one, np.append(is_assessed, np.ones(5, dtype=bool)))
    assert told[:6].tolist() == [0, 0, 0, 1, 0, 1]
    assert class_of_stated(np.zeros(3), np.ones(3, dtype=bool)).tolist() == [0, 0, 0]  # finished meshes
    assert class_of_stated(stated, np.zeros(6, dtype=bool)).tolist() == [0] * 6


def test_thirds_of_the_lever_arm_are_of_long_bodies_and_not_of_the_noise_of_round_ones(
    rng: np.random.Generator,
) -> None:
    """A body long by 5 % has thirds where its noise is stated, and is small beside what its arms differ by."""
    d = rng.normal(size=(3000, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    noisy, every = d * (0.1 + 5e-5 * rng.normal(size=(3000, 1))), np.ones(3000, dtype=bool)
    stated, unstated, coarse = (np.full(3000, sigma) for sigma in (5e-5, 0.0, 2e-4))

    def counts(stretch: float, noise: Floats) -> list[int]:
        return np.bincount(thirds_of(noisy * [1.0, 1.0, stretch], np.zeros(3), every, noise), minlength=3).tolist()

    for noise in (stated, unstated):
        assert counts(1.0, noise) == [3000, 0, 0]
        assert counts(4.0, noise) == pytest.approx([1000] * 3, abs=2)
    assert counts(1.05, stated) == pytest.approx([1000] * 3, abs=2)
    assert counts(1.05, unstated) == counts(1.05, coarse) == [3000, 0, 0]


def test_vertices_by_stratum_keep_their_order_within_one(rng: np.random.Generator) -> None:
    places, stratum = np.sort(rng.choice(9000, 3000, replace=False)), rng.integers(0, 5, 3000) * 7
    members, starts = sort_by_stratum(places, stratum)
    for k in range(N_STRATA):
        assert members[starts[k] : starts[k + 1]].tolist() == places[stratum == k].tolist()


def test_parts_are_mixed_as_they_say(rng: np.random.Generator) -> None:
    calm = calm_of(rng, np.ones(N_STRATA), np.full(500, SMOOTH))
    own, discord, shared = rng.uniform(0.0, 1e-3, (3, 500))
    calm, parts = calm._replace(own=own, discord=discord, shared=shared), Parts(0.7, 1.3, 0.4, 2e-4)
    expected = np.sqrt((0.7 * own) ** 2 + (1.3 * discord) ** 2 + (0.4 * shared) ** 2 + 2e-4**2)
    assert np.array_equal(noise_module._mix(calm, parts), expected)


@pytest.fixture
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a scale be learned from 2000 vertices, and 1000 on a side be many."""
    monkeypatch.setattr(noise_module, "N_LEARNT", 2000)
    monkeypatch.setattr(noise_module, "MANY", 1000)


def test_of_many_vertices_an_even_draw_teaches_and_of_a_small_class_all(
    rng: np.random.Generator, few_are_many: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    stratum = rng.permutation(np.repeat([SMOOTH, ROUGH], (20_000, 300)))
    true = np.full(N_STRATA, 0.6)
    true[ROUGH] = 1.2
    calm = [calm_of(rng, true, stratum) for _ in range(2)]
    drawn = noise_module._thin_out(calm)
    assert [len(c.places) for c in drawn] == [1015, 1015]  # each twentieth of 40 600
    for c, some in zip(calm, drawn, strict=True):
        assert np.array_equal(some.distances, c.distances[c.members[::20]])
    assert np.diff(drawn[0].starts)[[SMOOTH, ROUGH]].tolist() == [1000, 15]
    n_asked = {}

    def ask(calm: list[CalmVertices], members: Ints, factors: Floats, share: float) -> float:
        n_asked[tuple(members)] = sum(n_held(c, members) for c in calm)
        return asked_scale(calm, members, factors, share)

    monkeypatch.setattr(noise_module, "asked_scale", ask)
    _, scales = learn(calm, rng)
    assert scales[SMOOTH] == pytest.approx(0.6, rel=0.05)  # of 2000: a quantile known to 0.02
    assert scales[ROUGH] == pytest.approx(1.2, rel=0.1)  # of 600; of 30 a fifth
    of_class = {int(np.isin(SMOOTH, group)) + 2 * int(np.isin(ROUGH, group)): n for group, n in n_asked.items()}
    assert of_class == {1: 2000, 2: 600, 3: 2030}  # of the large class, of the small one, of both


def test_many_hold_as_many_witnesses_whichever_way_they_are_counted(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    stratum = rng.permutation(np.repeat([SMOOTH, MEDIUM, ROUGH], (3000, 2000, 1000)))
    calm = calm_of(rng, np.ones(N_STRATA), stratum)
    calm = calm._replace(points=rng.uniform(0.0, 1.0, (6000, 3)) * [1.0, 1.0, 0.0])
    calm.points[stratum == ROUGH] *= 0.1  # close together: few witnesses
    members, correlation = np.array([SMOOTH, ROUGH]), Correlation(np.array([0.8]), np.array([0.2]))
    counts = []
    for many in (10_000, 100):
        monkeypatch.setattr(noise_module, "MANY", many)
        counts.append(np.mean([noise_module._count([calm], members, correlation, rng) for _ in range(20)]))
    assert counts[1] == pytest.approx(counts[0], rel=0.03)  # the same draws of 1000, by other numbers
