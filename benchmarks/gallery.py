"""The figures of README.md and docs/: every figure of psmpc from short runs, the animation, the picture of the idea.

    python benchmarks/gallery.py                   writes docs/figures/, prints docs/gallery.md's grid; some 5 minutes

`make gallery` writes both. Each figure is that of the command that stands above it on the page.
"""

import base64
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
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
from psmpc_cli.figures import style
from psmpc_cli.figures.scene import scene_of
from psmpc_cli.figures.snapshots import draw_scene, show
from psmpc_cli.figures.timeline import draw_stages, place_bars

FIGURES = ROOT / "docs" / "figures"

COARSE = "--set controller.nodes=25"
DEBRIS = "{name: debris, shape: {sphere: 0.15}, pose: [0.7, 1.5, 0], velocity: [0.02, 0.05]}"
NOISY = "uncertainty={mass: 0.1, inertia: 0.1, noise: {position: 1e-3, angle: 1e-3}}"

COMMANDS: Mapping[str, str] = {
    "A robot": "psmpc check dual_arm_servicer --figure robot/robot.png",
    "A task": "psmpc check transport --figure scenario/scenario.png",
    "A run": f"psmpc simulate transport {COARSE} -o run.h5",
    "A run in space": "psmpc simulate servicing --set controller.nodes=12 --no-figures -o space.h5"
    " && psmpc plot space.h5 --only states --only snapshots",
    "A capture": f"psmpc simulate transport_grasp {COARSE} --no-figures -o capture.h5"
    " && psmpc plot capture.h5 --only grasps --only snapshots",
    "A capture that keeps clear": f"psmpc simulate catch_drifting {COARSE} --set clearance.margin=0.04 --set "
    f'"obstacles=[{DEBRIS}]" --no-figures -o clear.h5 && psmpc plot clear.h5 --only clearance --only snapshots',
    "A route round a panel": "psmpc simulate inspect_around --no-figures -o route.h5"
    " && psmpc plot route.h5 --only clearance --only snapshots",
    "A base that floats": "psmpc simulate float_and_reach --no-figures -o float.h5"
    " && psmpc plot float.h5 --only snapshots",
    "A robot that is not the model": f"psmpc simulate transport {COARSE} --set uncertainty.mass=0.1 "
    "--set uncertainty.noise.position=1e-3 --no-figures -o uncertain.h5 && psmpc plot uncertain.h5 --only velocities",
    "A comparison": f"psmpc compare transport --controllers psmpc,smpc,hard {COARSE} -o comparison.h5",
    "A sweep over the priorities": "psmpc sweep-weights 9x9 --set controller.nodes=12 -o sweep.h5",
    "Random priorities": "psmpc sweep-weights --sampling random:30 --set controller.nodes=12 -o draws.h5",
    "Pareto fronts": "psmpc pareto --points 25 --method weighted-sum --set controller.nodes=25 -o pareto.h5",
    "Pareto fronts with the switch time as a criterion": "psmpc pareto --free-instant --points 13 "
    "--method weighted-sum --set controller.nodes=25 -o free.h5",
    "A Monte Carlo study": f'psmpc monte-carlo transport --runs 20 --set controller.nodes=12 --set "{NOISY}" '
    "-o study.h5",
    "The reproduction of the paper": "psmpc reproduce --ablations --weights 5x5 --set controller.nodes=12 -o reproduce",
}
"""What is run, by the heading of its figures, in this order; a later command may read what an earlier one wrote."""

REPORTED = {"adds to the control": "presence", "monitored quantities": "monitors", "triangles their ends": "schedule"}
"""Figures that a report alone has, by words of their captions there."""

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
    for (bars, picture), (title, run), scene in zip(columns, runs.items(), scenes, strict=True):
        draw_stages(bars, place_bars(run.spans, (0.0, latest), width=style.AXIS_WIDTH))
        bars.axvline(EARLY, color="black", linewidth=0.8, linestyle=":")
        bars.set_title(f"{title}, done after {run.motion.end:.1f} s", loc="left", fontsize=8.0)
        bars.set(xlim=(0, latest), yticks=[], xlabel="Time (s)")
        bars.invert_yaxis()
        draw_scene(picture, scene, EARLY, EARLY - 3.0, points)
        show(picture, scene.camera, scene.camera.view(points))
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
    for heading, command in COMMANDS.items():
        sys.stderr.write(f"{command}\n")
        lines = command.split(" && ")
        for line in lines:
            run_psmpc(line, folder, check=True)
        yield from ("", f"## {heading}", "", "```", *lines, "```", "", '<div class="gallery" markdown>', "")
        for path in figures_in(folder):
            if path not in seen:
                seen.add(path)
                place = f"gallery/{path.parent.name}_{path.stem}.png"
                shrink(path, FIGURES / place)
                picture, caption = f"![{path.stem}](figures/{place})", f"<figcaption>{path.stem}</figcaption>"
                yield from ("<figure markdown>", picture, caption, "</figure>")
        yield from ("", "</div>")


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
