"""Graphs whose spectra are known in closed form (Brouwer and Haemers, Spectra of Graphs, section 1.4)."""

from __future__ import annotations

import numpy as np


def path(n):
    edges = np.array([(i, i + 1) for i in range(n - 1)]).reshape(-1, 2)
    return n, edges, 2 - 2 * np.cos(np.pi * np.arange(n) / n)


def cycle(n):
    edges = np.array([(i, (i + 1) % n) for i in range(n)])
    return n, np.sort(edges, axis=1), 2 - 2 * np.cos(2 * np.pi * np.arange(n) / n)


def star(n):
    edges = np.array([(0, i) for i in range(1, n)])
    return n, edges, np.array([0.0] + [1.0] * (n - 2) + [float(n)])


def complete(n):
    edges = np.array([(i, j) for i in range(n) for j in range(i + 1, n)])
    return n, edges, np.array([0.0] + [float(n)] * (n - 1))


def grid(rows, columns):
    index = np.arange(rows * columns).reshape(rows, columns)
    right = np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], axis=1)
    down = np.stack([index[:-1].ravel(), index[1:].ravel()], axis=1)
    spectrum = np.add.outer(path(rows)[2], path(columns)[2]).ravel()
    return rows * columns, np.concatenate([right, down]), spectrum


def path_kernel_diagonal(n, times):
    """K_ii(t) of a path: φ_k(i) = √(2/n) cos(π k (i + ½) / n) for k > 0."""
    eigenvalues = path(n)[2]
    modes = np.sqrt(2 / n) * np.cos(np.pi * np.outer(np.arange(n) + 0.5, np.arange(n)) / n)
    modes[:, 0] = 1 / np.sqrt(n)
    return modes**2 @ np.exp(-np.outer(eigenvalues, times))


FAMILIES = {
    "path": path(17),
    "cycle": cycle(16),
    "star": star(9),
    "complete": complete(8),
    "grid": grid(4, 7),
    "edge": path(2),
}
