"""A map kept between closures: `grown_map` predicts without an optimum, by `kept_optimum` and `known_closures`."""
