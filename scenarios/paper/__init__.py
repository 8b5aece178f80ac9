"""The paper whole: its curves (6.2), Table 4 and Figure 6 (6.3), its limits (7) and active SLAM (8), from scratch."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pgti_gtsam import outputs
from scenarios.paper import beyond, curves, growth, scale, table, texture
from scenarios.paper.figure import draw_growth, draw_maps, draw_signatures


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
    tell("section 7: growth, texture")
    found["growth"] = growth.run(tell)
    found["texture"] = texture.run()
    tell("section 8: robots, control points")
    found |= {"robots": beyond.robots(), "control_points": beyond.control_points()}
    tell("replay at size")
    found["scale"] = scale.run()

    # written first, drawn from what was written
    path = folder / "paper.json"
    outputs.write_text(path, json.dumps(found, ensure_ascii=False) + "\n")
    written = json.loads(path.read_text(encoding="utf-8"))
    draw_signatures(written["table_4"], folder / "figure_3.png")
    draw_maps(written["table_4"], folder / "figure_6.png")
    draw_growth(written["growth"], folder / "growth.png")
    return found


def report(found: dict[str, Any]) -> list[str]:
    """All tables, as RESULTS.md has them."""
    bursts = [f"{name.replace('_', ' ')} {found['curves'][name]['bursts']}" for name in ("figure_4", "figure_5")]
    # section 6
    lines = [
        f"edges are inserted from keyframe to keyframe: {', '.join(bursts)}\n",
        *curves.markdown(found["curves"]),
        "\nwhat Z̄, Λ and the stable score keep between the two bursts of Fig. 5\n",
        *curves.blur_markdown(found["curves"]),
        f"lag of ΔẼ with uneven covisibility: {curves.uneven_markdown(found['curves'])}",
        "\nTable 4, medians of (Λ_loc, Λ_glob)\n",
        *table.markdown(found["table_4"]),
        "\nΛ by the time grid (the merged graph's for both, or each graph's own) and the norm\n",
        *table.readings_markdown(found["table_4"]),
        "\nthe same layouts by scores that do not fade\n",
        *table.steady_markdown(found["table_4"]),
    ]

    # sections 7 and 8
    lines += [
        "\nwhat a grown map keeps of each score\n",
        *growth.markdown(found["growth"]),
        "\nplaces without texture\n",
        *texture.markdown(found["texture"]),
        "\ntwo robots\n",
        *beyond.robots_markdown(found["robots"]),
        "\ncontrol points\n",
        *beyond.control_markdown(found["control_points"]),
        "\nreplay at size\n",
        *scale.markdown(found["scale"]),
    ]
    return lines
