"""RTAB-Map databases (``.db``, SQLite): nodes are keyframes, links are odometry, closures or sightings of tags.

Several sessions (``map_id``) are told apart by the letter of the keys. See `rtabmap_database`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgti_gtsam.datasets.assembly import Entry, assemble
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, sightings
from pgti_gtsam.datasets.noise import information_models
from pgti_gtsam.datasets.rtabmap_database import LANDMARK, MAGIC, UNARY, Link, links, nodes, opened
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import Table, TextFile
from pgti_gtsam.factor_graphs import between_factor

NAME = "RTAB-Map database"
CLOSURES = {1: "global closures", 2: "closures local in space", 3: "closures local in time", 4: "closures by the user"}
NEIGHBOURS = {0: "neighbours", 6: "merged neighbours"}
KINDS = {**NEIGHBOURS, LANDMARK: "sightings of tags", 5: "virtual links left out", **CLOSURES}


def parse(source: Source) -> Dataset:
    """The graph of a database; the types of the links tell the closures.

    Raises
    ------
    FileFormatError
        No database of RTAB-Map, a damaged one, or one without poses or links.
    """
    file = source.blank()
    with opened(source) as database:
        keys, poses = nodes(database, file)
        found = links(database, poses)
        unary = database.execute(UNARY).fetchone()[0]

    # what kinds of links there are
    file.notes.extend([f"{unary} pose priors and gravity links left out"] if unary else [])
    counts = Counter(link.type for link in found)
    file.notes.extend(f"{counts[kind]} {KINDS[kind]}" for kind in sorted(counts.keys() & KINDS.keys()))
    unknown = {kind: counts[kind] for kind in sorted(counts.keys() - KINDS.keys())}
    if unknown and not source.ignore_unknown:
        shown = ", ".join(f"{count} of type {kind}" for kind, count in unknown.items())
        raise file.error(f"links tie nodes in a way that is not known: {shown}; leave them out with --ignore-unknown")
    ties, tags = ([link for link in found if link.type in kinds] for kinds in ((*NEIGHBOURS, *CLOSURES), (LANDMARK,)))

    # those between keyframes as factors
    information = np.array([link.information for link in ties]).reshape(-1, 6, 6)
    models = information_models(file, _table(ties, keys), information)
    ends = [(keys[link.first], keys[link.second]) for link in ties]
    rows = enumerate(zip(ends, ties, models, strict=True))
    entries = [Entry(slot, pair, between_factor(*pair, link.pose, model)) for slot, (pair, link, model) in rows]
    odometry, loops = (
        [entry for entry, link in zip(entries, ties, strict=True) if link.type in kinds]
        for kinds in (NEIGHBOURS, CLOSURES)
    )

    # the map, under the database's own names
    dataset = assemble(
        file,
        format=NAME,
        poses={keys[node]: pose for node, pose in poses.items() if node in keys},
        entries=odometry,
        loops=loops,
        sightings=[seen._replace(line=len(entries)) for seen in _sightings(file, tags, keys)],
    )
    names = {key: str(node) for node, key in keys.items()}
    return replace(dataset, names=names, ignored_edges=sum(unknown.values()))


def _table(links: Sequence[Link], keys: Mapping[int, int]) -> Table:
    ids = np.array([(keys[link.first], keys.get(link.second, abs(link.second))) for link in links], np.int64)
    return Table(lines=np.arange(len(links)), ids=ids.reshape(-1, 2), numbers=np.empty((len(links), 0)))


def _sightings(file: TextFile, tags: Sequence[Link], keys: Mapping[int, int]) -> list[Sighting]:
    matrices = np.array([link.pose.matrix() for link in tags]).reshape(-1, 4, 4)
    turns, blocks = matrices[:, :3, :3], np.array([link.information[3:, 3:] for link in tags]).reshape(-1, 3, 3)
    return sightings(file, _table(tags, keys), matrices[:, :3, 3], turns @ blocks @ turns.transpose(0, 2, 1))


FORMAT = Format(NAME, lambda source: source.head.startswith(MAGIC), parse)
