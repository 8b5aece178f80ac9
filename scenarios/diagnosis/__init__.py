"""Does `diagnose` say the right thing? Maps with known damage, and their verdicts against the truth.

1. A course through a ray-cast world (`courses`) becomes a map with all its true ties (`sparse`, `covisible`); real
   graphs are taken at their optimum (`real`).
2. The map is damaged (`damage`) and optimised.
3. The truth gives the right verdict (`expectation`), whatever the damage is called.
4. A row of numbers a case (`trials`, run by `scenarios.sweep`), then tables and maps (`tables`, `maps`).
"""
