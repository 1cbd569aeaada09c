"""The solver of the field: the assembled system, fixed nodes, and how fast it gets there."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.linalg import LinearOperator, cg, spsolve

from monitor.reconstruction.band import index_nodes, link_nodes
from monitor.reconstruction.conjugate_gradients import solve_field

SHAPE = np.array([40, 40, 9])  # a sheet and the band about it, held by its middle layer


@pytest.fixture(scope="module")
def sheet():
    """Links, screening and the assembled matrix of a sheet's band that lacks some nodes."""
    rng = np.random.default_rng(3)
    nodes = np.stack(np.unravel_index(np.arange(SHAPE.prod()), SHAPE), axis=1).astype(np.int32)
    hole = (np.abs(nodes[:, :2] - 12) < 4).all(axis=1) & (nodes[:, 2] != 4)
    nodes = nodes[~hole]
    index = index_nodes(nodes, SHAPE)
    links, n = link_nodes(nodes, index), len(nodes)
    cells = np.argwhere(np.ones((39, 39), bool)) @ [[1, 0, 0], [0, 1, 0]] + [0, 0, 4]
    corner = (cells[:, None] + np.stack([np.arange(8) & 1, np.arange(8) >> 1 & 1, np.arange(8) >> 2], axis=1)).T
    corners = index[tuple(corner)].T
    known = (corners >= 0).all(axis=1)
    corners, weights = corners[known], rng.dirichlet(np.ones(8), known.sum()).astype(np.float32)
    pull = rng.uniform(0.2, 0.44, len(corners)).astype(np.float32)
    pairs = [(i, links[0, axis, i]) for axis in range(3) for i in range(n) if links[0, axis, i] < n]
    a, b = np.array(pairs).T.astype(int)
    values = np.concatenate([np.full(2 * len(a), -1.0), np.ones(2 * len(a))])
    laplacian = coo_array((values, (np.r_[a, b, a, b], np.r_[b, a, a, b])), shape=(n, n))
    of_cells = np.repeat(np.arange(len(corners)), 8)
    rows = coo_array(((np.sqrt(pull)[:, None] * weights).ravel(), (of_cells, corners.ravel())), shape=(len(corners), n))
    return links, (corners, weights, pull), (laplacian + rows.T @ rows).tocsc(), rng.normal(size=n).astype(np.float32)


def test_the_assembled_system_is_solved(sheet):
    links, screening, matrix, rhs = sheet
    x = np.random.default_rng(4).normal(size=len(rhs)).astype(np.float32)
    solve_field(x, rhs, links, screening, np.zeros(len(rhs), np.bool_), 1e-7, 1000)
    true = spsolve(matrix, rhs.astype(float))
    assert np.abs(x - true).max() < 2e-5 * np.abs(true).max()


def test_fixed_nodes_keep_their_values_and_hold_the_rest(sheet):
    links, screening, matrix, rhs = sheet
    rng = np.random.default_rng(5)
    is_fixed = rng.random(len(rhs)) < 0.1
    start = rng.normal(size=len(rhs)).astype(np.float32)
    x = start.copy()
    solve_field(x, rhs, links, screening, is_fixed, 1e-7, 1000)
    assert (x[is_fixed] == start[is_fixed]).all()
    free = ~is_fixed
    true = spsolve(matrix[free][:, free], rhs[free] - matrix[free][:, is_fixed] @ start[is_fixed].astype(float))
    assert np.abs(x[free] - true).max() < 2e-5 * np.abs(true).max()


def test_it_takes_a_quarter_of_the_steps_of_a_diagonal_preconditioner(sheet):
    links, screening, matrix, rhs = sheet
    steps = []
    diagonal = matrix.diagonal()
    by_diagonal = LinearOperator(matrix.shape, matvec=lambda v: v / diagonal)
    plain, _ = cg(matrix, rhs.astype(float), rtol=1e-6, M=by_diagonal, callback=steps.append)
    x = np.zeros(len(rhs), np.float32)
    n_steps = solve_field(x, rhs, links, screening, np.zeros(len(rhs), np.bool_), 1e-6, 1000)
    true = spsolve(matrix, rhs.astype(float))
    assert np.linalg.norm(x - true) < 1.5 * np.linalg.norm(plain - true)
    assert 4 * n_steps < len(steps)
