"""The paper whole: its curves (6.2), Table 4 and Figure 6 (6.3), its limits (7) and active SLAM (8), from scratch."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pgti_gtsam import outputs
from scenarios.paper import beyond, curves, growth, table, texture
from scenarios.paper.figure import draw_growth, draw_maps

FALSE_LOOP_SEED = 0


def run(data: Path | None, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Everything but the benchmark of section 8; figures and `paper.json` go to the folder.

    Parameters
    ----------
    data : Path, optional
        Folder of all data.
    folder : Path
        Folder of the results.
    tell : callable
        Called with a line of progress.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tell("section 6.2: curves")
    found: dict[str, Any] = {"curves": curves.run(folder)}
    tell("section 6.3: Table 4")
    found["table_4"] = table.run(data, tell)
    found["false_loops"] = table.false_loops(FALSE_LOOP_SEED)
    found["side_loops"] = table.side_loops()
    found["drifts"] = [] if data is None else table.drifts(data)
    tell("section 7: growth, texture")
    found["growth"] = growth.run(tell)
    found["texture"] = texture.run()
    tell("section 8: robots, control points")
    found |= {"robots": beyond.robots(), "control_points": beyond.control_points()}

    # written first, drawn from what was written
    path = folder / "paper.json"
    outputs.write_text(path, json.dumps(found, ensure_ascii=False) + "\n")
    written = json.loads(path.read_text(encoding="utf-8"))
    draw_maps(written["table_4"], folder / "figure_6.png")
    draw_growth(written["growth"], folder / "growth.png")
    return found


def report(found: dict[str, Any]) -> list[str]:
    """All tables, as RESULTS.md has them."""
    false = found["false_loops"]
    low, middle, high = false["quartiles"]
    bursts = [f"{name.replace('_', ' ')} {found['curves'][name]['bursts']}" for name in ("figure_4", "figure_5")]
    return [
        f"edges are inserted from keyframe to keyframe: {', '.join(bursts)}\n",
        *curves.markdown(found["curves"]),
        "\nwhat Z̄, Λ and the stable score keep between the two bursts of Fig. 5\n",
        *curves.blur_markdown(found["curves"]),
        "\nTable 4, (Λ_loc, Λ_glob)\n",
        *table.markdown(found["table_4"]),
        f"\n{false['n']} drawn false loops, sized as row (g): Λ quartiles {low:.2f}, {middle:.2f}, {high:.2f}, largest "
        f"{false['largest']:.2f}, above 1 in {false['above_1']}, global part the larger in {false['global_dominates']}",
        "the side loop of row (d) by the way behind it: "
        + ", ".join(f"{each['behind_m']} m {each['ratio']:.1f}" for each in found["side_loops"]),
        "KITTI 00 by its drift a kilometre: "
        + ", ".join(f"{each['per_km']:.0%} Λ {each['score']:.2f}" for each in found["drifts"]),
        "\nΛ by the time grid (the merged graph's for both, or each graph's own) and the norm\n",
        *table.readings_markdown(found["table_4"]),
        "\nwhat a grown map keeps of each score\n",
        *growth.markdown(found["growth"]),
        "\nplaces without texture\n",
        *texture.markdown(found["texture"]),
        "\ntwo robots\n",
        *beyond.robots_markdown(found["robots"]),
        "\ncontrol points\n",
        *beyond.control_markdown(found["control_points"]),
    ]
