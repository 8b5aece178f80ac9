"""Does `diagnose` say the right thing? Maps with known damage, their verdicts against what the truth says of them.

1. A course through a ray-cast world (`courses`) becomes a map with all its true ties (`sparse`, `covisible`); real
   graphs are taken at their optimum (`real`).
2. The map is damaged (`damage`) and optimised.
3. The truth says what the verdict should be (`expectation`), whatever the damage is called.
4. One row of numbers a case (`trials`, run by `scenarios.sweep`), tables and maps from those (`tables`, `maps`).
"""
