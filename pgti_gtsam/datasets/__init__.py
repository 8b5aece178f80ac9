"""Factor graphs from files: one reader per format, the format found from the content; and to g2o files."""

from pgti_gtsam.datasets.chain import chain_odometry, closure_slots
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.g2o_writer import Written, write_g2o
from pgti_gtsam.datasets.links import read_links
from pgti_gtsam.datasets.one_map import read_one_map
from pgti_gtsam.datasets.reader import BUILTIN, builtin, is_map, read, read_carmen
from pgti_gtsam.datasets.subsample import subsample

__all__ = [
    "BUILTIN",
    "Dataset",
    "Written",
    "builtin",
    "chain_odometry",
    "closure_slots",
    "is_map",
    "read",
    "read_carmen",
    "read_links",
    "read_one_map",
    "subsample",
    "write_g2o",
]
