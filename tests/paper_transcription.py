"""The paper's equations, transcribed one by one with loops and full matrices: slow, and only for tests."""

from __future__ import annotations

import math

import numpy as np


def components(n, edges):
    """Vertex sets of the connected components, by flooding."""
    neighbours = {i: set() for i in range(n)}
    for i, j in edges:
        neighbours[i].add(j)
        neighbours[j].add(i)
    left, found = set(range(n)), []
    while left:
        reached, front = set(), {min(left)}
        while front:
            reached |= front
            front = {j for i in front for j in neighbours[i]} - reached
        found.append(sorted(reached))
        left -= reached
    return found


def laplacian(n, edges):
    matrix = np.zeros((n, n))
    for i, j in edges:
        matrix[i, j] = matrix[j, i] = -1.0
        matrix[i, i] += 1
        matrix[j, j] += 1
    return matrix


def positive_spectrum(n, edges):
    """{λ_k, φ_k | λ_k > 0}: as many smallest eigenvalues left out as there are components."""
    eigenvalues, vectors = np.linalg.eigh(laplacian(n, edges))
    skip = len(components(n, edges))
    return eigenvalues[skip:], vectors[:, skip:]


def scaled_signature(n, edges, times):
    """Eq. 3 and 4."""
    eigenvalues, vectors = positive_spectrum(n, edges)
    psi = np.zeros((n, len(times)))
    if len(eigenvalues) == 0:
        return psi
    touched = {i for edge in edges for i in edge}
    for column, t in enumerate(times):
        shifted = [math.exp(-(value - eigenvalues[0]) * t) for value in eigenvalues]
        for i in touched:
            heat = sum(decay * vectors[i, k] ** 2 for k, decay in enumerate(shifted))
            psi[i, column] = heat / sum(shifted)
    return psi


def free_space_edges(positions, radii):
    """Eq. 13 gives the radii; an edge wherever two spheres intersect."""
    found = set()
    for i in range(len(radii)):
        for j in range(i + 1, len(radii)):
            if np.linalg.norm(positions[i] - positions[j]) <= radii[i] + radii[j]:
                found.add((i, j))
    return found


def assess(positions, edges, radii, n_times=100, beta=0.5, p=2):
    """Λ, Λ_loc, Λ_glob and Z (Eq. 14 to 19)."""
    n = len(positions)
    pose_edges = {(min(i, j), max(i, j)) for i, j in edges}
    merged = pose_edges | free_space_edges(positions, radii)
    spectrum, _ = positive_spectrum(n, sorted(merged))
    first, last = (spectrum[-1], spectrum[0]) if len(spectrum) else (1.0, 1.0)
    times = np.geomspace(4 * math.log(10) / first, 4 * math.log(10) / last, n_times)
    psi_p, psi_m = (scaled_signature(n, sorted(graph), times) for graph in (pose_edges, merged))
    scores = [distortion(psi_p[i], psi_m[i], p) for i in range(n)]
    worst = int(np.argmax(scores))
    cut = min(max(round(beta * n_times), 1), n_times - 1)
    return {
        "Z": np.array(scores),
        "Lambda": scores[worst],
        "local": distortion(psi_p[worst, :cut], psi_m[worst, :cut], p),
        "global": distortion(psi_p[worst, cut:], psi_m[worst, cut:], p),
    }


def distortion(before, after, p):
    """Eq. 17."""
    change = sum(abs(a - b) ** p for a, b in zip(after, before, strict=True)) ** (1 / p)
    size = sum(abs(b) ** p for b in before) ** (1 / p)
    if size == 0:
        return 0.0 if change == 0 else math.inf
    return change / size
