"""How far two keyframes may lie apart, given every tie of a map, and what that says of closures.

`ties` and `upright` read the constraints of a map, `model` holds them, `settled` is their optimum with the predicted
relative poses, and `log_odds` weighs closures against these. `left_out` predicts each tie by all others, by which
`own_closures` judges the closures of a finished map.
"""
