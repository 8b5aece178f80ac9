"""The gate in front of GTSAM's smoothers: closures come one by one, may wait, and are judged again.

`gated` is common to all kinds, `isam2` and `fixed_lag` are the kinds; `history` is what was offered, `kept_map` the map
between closures, `remembered` what has left a window, and `saved` all of it in a file.
"""
