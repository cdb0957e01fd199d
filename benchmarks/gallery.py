"""The figures of README.md and docs/: every figure of psmpc from short runs, the animation, the picture of the idea.

    python benchmarks/gallery.py                   writes docs/figures/, prints docs/gallery.md's grid; some 5 minutes

`make gallery` writes both. Each figure is that of the command that stands above it on the page.
"""

import base64
import re
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pages import ROOT, run_psmpc
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

import psmpc_cli as psmpc
from psmpc_cli.figures import registry, style
from psmpc_cli.figures.scene import scene_of
from psmpc_cli.figures.snapshots import draw_scene, set_view
from psmpc_cli.figures.timeline import draw_stages, place_bars
from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP

FIGURES = ROOT / "docs" / "figures"

COARSE = "--set controller.nodes=25"
DEBRIS = "{name: debris, shape: {sphere: 0.15}, pose: [0.7, 1.5, 0], velocity: [0.02, 0.05]}"
NOISY = "uncertainty={mass: 0.1, inertia: 0.1, noise: {position: 1e-3, angle: 1e-3}}"


@dataclass(frozen=True)
class Shown:
    """A section of the page.

    Attributes:
        heading: What its figures are of.
        command: What makes them; several after each other are joined by &&.
        kind: What the figures are of, as in the registry; empty for those of a report.
    """

    heading: str
    command: str
    kind: str


SECTIONS: Mapping[str, Sequence[Shown]] = {
    "Planar robot with two arms, transport": (
        Shown("The task", "psmpc check transport --figure scenario/scenario.png", "scenario"),
        Shown("One run", f"psmpc simulate transport {COARSE} -o run.h5", RUN),
        Shown(
            "Three controllers compared",
            f"psmpc compare transport --controllers psmpc,smpc,hard {COARSE} -o comparison.h5",
            COMPARISON,
        ),
        Shown("Priorities on a grid", "psmpc sweep-weights 9x9 --set controller.nodes=12 -o sweep.h5", SWEEP),
        Shown(
            "Random priorities",
            "psmpc sweep-weights --sampling random:30 --set controller.nodes=12 -o draws.h5",
            SWEEP,
        ),
        Shown(
            "Pareto fronts",
            "psmpc pareto --points 25 --method weighted-sum --set controller.nodes=25 -o pareto.h5",
            PARETO,
        ),
        Shown(
            "Pareto fronts with the switch time as a criterion",
            "psmpc pareto --free-instant --points 13 --method weighted-sum --set controller.nodes=25 -o free.h5",
            PARETO,
        ),
        Shown(
            "Uncertain runs",
            f'psmpc monte-carlo transport --runs 20 --set controller.nodes=12 --set "{NOISY}" -o study.h5',
            MONTE_CARLO,
        ),
        Shown(
            "A robot that is not the model",
            f"psmpc simulate transport {COARSE} --set uncertainty.mass=0.1 --set uncertainty.noise.position=1e-3 "
            "--no-figures -o uncertain.h5 && psmpc plot uncertain.h5 --only velocities",
            RUN,
        ),
        Shown(
            "The paper reproduced",
            "psmpc reproduce --ablations --weights 5x5 --set controller.nodes=12 -o reproduce",
            "",
        ),
    ),
    "Planar robot with two arms, capture of a body": (
        Shown(
            "Grasps of an object at rest",
            f"psmpc simulate transport_grasp {COARSE} --no-figures -o capture.h5"
            " && psmpc plot capture.h5 --only grasps --only snapshots",
            RUN,
        ),
        Shown(
            "A drifting object, and debris to keep clear of",
            f"psmpc simulate catch_drifting {COARSE} --set clearance.margin=0.04 --set "
            f'"obstacles=[{DEBRIS}]" --no-figures -o clear.h5 && psmpc plot clear.h5 --only clearance --only snapshots',
            RUN,
        ),
    ),
    "Planar robot with two arms, other missions": (
        Shown(
            "A route round a panel",
            "psmpc simulate inspect_around --no-figures -o route.h5"
            " && psmpc plot route.h5 --only clearance --only snapshots",
            RUN,
        ),
        Shown(
            "A base that floats",
            "psmpc simulate float_and_reach --no-figures -o float.h5 && psmpc plot float.h5 --only snapshots",
            RUN,
        ),
        Shown(
            "Thrusters that are on or off",
            "psmpc simulate thrust_and_reach --no-figures -o thrust.h5 && psmpc plot thrust.h5 --only thrusters",
            RUN,
        ),
        Shown(
            "Reaction wheels",
            "psmpc simulate turn_and_look --no-figures -o turn.h5 && psmpc plot turn.h5 --only wheels",
            RUN,
        ),
    ),
    "Spatial servicer with two arms of seven joints": (
        Shown("The robot", "psmpc check dual_arm_servicer --figure robot/robot.png", "robot"),
        Shown(
            "One run of servicing",
            "psmpc simulate servicing --set controller.nodes=12 --no-figures -o space.h5"
            " && psmpc plot space.h5 --only states --only snapshots",
            RUN,
        ),
        Shown(
            "A tumbling satellite",
            "psmpc simulate capture_and_detumble --no-figures -o tumbling.h5"
            " && psmpc plot tumbling.h5 --only snapshots",
            RUN,
        ),
    ),
}
"""What is run, by robot and mission, in the order of the page; a later command may read what an earlier one wrote."""

REPORTED = {"adds to the control": "presence", "monitored quantities": "monitors", "triangles their ends": "schedule"}
"""Figures that a report alone has, by words of their captions there."""

CAPTIONS: Mapping[str, str] = {
    "presence": "How far each waiting stage is in the control already; it starts where that reaches the threshold.",
    "monitors": "The monitored distance of the grippers, with its bound while it counts.",
    "schedule": "The stages under each controller; triangles are their published ends.",
    "ablation_pending_cost": "Planned switch times and control with and without a positive pending cost.",
    "ablation_normalization": "Stages, planned switch times and control with each way to normalize the costs.",
    "ablation_discretization": "Prediction error, miss at the switch and end of the run for exact and Euler steps.",
}
"""What the figures of a report show, by name."""

EARLY = 8.0
"""When the picture of the idea shows the robot [s]: Approach goes on, and Capture already acts."""


def figures_in(folder: Path) -> Iterator[Path]:
    """Yield the figures below a folder, those inside a report too."""
    for report in folder.glob("*/report.html"):
        found = re.findall(r'base64,([^"]+)".*?<figcaption>(.*?)</figcaption>', report.read_text("utf-8"), re.DOTALL)
        for data, caption in found:
            name = next((name for words, name in REPORTED.items() if words in caption), None)
            if name is not None:
                (report.parent / f"{name}.png").write_bytes(base64.b64decode(data))
    yield from sorted(folder.glob("*/*.png"))


def concept(overlapped: psmpc.Run, hard: psmpc.Run) -> Figure:
    """Draw the idea: the stages of both runs as bars, and the robot of each at the same time."""
    runs = {"Hard switching: one stage after another": hard, "PSMPC: the next stage acts early": overlapped}
    figure = Figure(figsize=(style.PAGE, 4.3), layout="constrained")
    scenes = [scene_of(run) for run in runs.values()]
    points = np.vstack([scene.extent([EARLY]) for scene in scenes])
    latest = max(run.motion.end for run in runs.values())
    columns = figure.subplots(2, 2, height_ratios=[1.0, 2.6]).T
    placed = place_bars([run.spans for run in runs.values()], (0.0, latest), width=style.AXIS_WIDTH)
    for (bars, picture), (title, run), of_run, scene in zip(columns, runs.items(), placed, scenes, strict=True):
        draw_stages(bars, of_run)
        bars.axvline(EARLY, color="black", linewidth=0.8, linestyle=":")
        bars.set_title(f"{title}, done after {run.motion.end:.1f} s", loc="left", fontsize=8.0)
        bars.set(xlim=(0, latest), yticks=[], xlabel="Time (s)")
        bars.invert_yaxis()
        draw_scene(picture, scene, EARLY, EARLY - 3.0, points)
        set_view(picture, scene.camera, scene.camera.view(points))
        picture.set_title(f"at {EARLY:.0f} s: {', '.join(scene.events(EARLY))}", loc="left", fontsize=8.0)
    FigureCanvasAgg(figure)
    return figure


def photograph(page: Path, target: Path) -> None:
    """Write a picture of a run's interactive page at EARLY; without Chromium and its driver the old picture stays."""
    chromium, driver = (shutil.which(name) for name in ("chromium", "chromedriver"))
    if chromium is None or driver is None:
        sys.stderr.write("found no Chromium with its driver: the picture of the page stays as it is\n")
        return
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader"):
        options.add_argument(option)
    options.add_argument("--enable-unsafe-swiftshader")
    with webdriver.Chrome(options, webdriver.ChromeService(driver)) as browser:
        browser.set_window_size(1300, 1040)
        browser.get(page.as_uri())
        for _ in range(round(EARLY)):
            ActionChains(browser).key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()
        sleep(1.0)
        browser.save_screenshot(str(page.with_suffix(".png")))
    shrink(page.with_suffix(".png"), target, 1300)


def shrink(path: Path, target: Path, width: int = 1100) -> None:
    """Write an image with a palette and at most this width [px]."""
    image = Image.open(path).convert("RGB")
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    target.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(128, dither=Image.Dither.NONE).save(target, optimize=True)


def grid(folder: Path) -> Iterator[str]:
    """Run the commands in a folder, write their figures, and yield the lines of the page's grid."""
    seen: set[Path] = set()
    used: set[str] = set()
    for robot, sections in SECTIONS.items():
        yield from ("", f"## {robot}")
        for shown in sections:
            sys.stderr.write(f"{shown.command}\n")
            lines = shown.command.split(" && ")
            for line in lines:
                run_psmpc(line, folder, check=True)
            yield from ("", f"### {shown.heading}", "", "```", *lines, "```", "", '<div class="gallery" markdown>', "")
            new = {path.stem: path for path in figures_in(folder) if path not in seen}
            captions = {
                name: figure.caption for name, figure in registry.FIGURES.get(shown.kind, {}).items()
            } or CAPTIONS
            for name in (name for name in captions if name in new):
                place = f"gallery/{new[name].parent.name}_{name}.png"
                shrink(new[name], FIGURES / place)
                caption = captions[name] if captions[name] not in used else f"{shown.heading}. {captions[name]}"
                used.add(captions[name])
                picture = f"![{caption}](figures/{place})"
                yield from ("<figure markdown>", picture, f"<figcaption>{caption}</figcaption>", "</figure>")
            yield from ("", "</div>")
            seen.update(new.values())


def main() -> None:
    """Write every figure, and print the page's grid."""
    shutil.rmtree(FIGURES / "gallery", ignore_errors=True)
    with TemporaryDirectory() as name:
        folder = Path(name)
        for line in grid(folder):
            print(line, flush=True)
        run_psmpc("psmpc plot run.h5 --animate --only states -o animation", folder, check=True)
        (FIGURES / "transport.gif").write_bytes((folder / "animation" / "animation.gif").read_bytes())
        run_psmpc("psmpc view run.h5", folder, check=True)
        photograph(folder / "run-view.html", FIGURES / "view.png")
        run_psmpc(f"psmpc simulate transport --controller hard {COARSE} --no-figures -o hard.h5", folder, check=True)
        with style.in_style():
            figure = concept(psmpc.read_run(folder / "run.h5"), psmpc.read_run(folder / "hard.h5"))
            figure.savefig(FIGURES / "concept.png", dpi=200)
    shrink(FIGURES / "concept.png", FIGURES / "concept.png", 1400)


if __name__ == "__main__":
    main()
