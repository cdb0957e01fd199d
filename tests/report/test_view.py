"""The viewer's page in a browser: what it draws, how it moves, and that it agrees with the robot's kinematics."""

import io
import json
import re
from base64 import b64decode
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from scipy.spatial.transform import Rotation
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver

from psmpc_cli.errors import InputError
from psmpc_cli.figures.scene import capsules, scene_of
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.report.pages import report_run
from psmpc_cli.report.view import view
from psmpc_cli.robot.geometry import pieces_of
from psmpc_cli.simulation.run import simulate

from ..free_flyer import turning
from ..plumed import FOLDED, before_a_panel
from ..short_runs import CUT, there_and_back
from ..synthetic_logs import Story, story_among_obstacles, write_story
from ..wheeled import planar_in
from .browser import opened_browser

SIZES = ((360, 740), (1400, 860))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Ten centimetres there and back."""
    return there_and_back(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with opened_browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


def opened(browser: WebDriver, runs: Any, path: Path, width: int = 1400, height: int = 860) -> None:
    """Write a page and open it in a window of a size [px]."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(view(runs).save(path, force=True).as_uri())


def pixels(browser: WebDriver) -> np.ndarray:
    """The scene as an image (height, width, 3)."""
    image = Image.open(io.BytesIO(browser.find_element(By.ID, "canvas").screenshot_as_png))
    return np.asarray(image.convert("RGB"), float)


def seek(browser: WebDriver, time: float) -> None:
    browser.execute_script("psmpc.seek(arguments[0])", time)


def time_of(browser: WebDriver) -> float:
    """The time the page shows [s]."""
    return float(browser.execute_script("return new Promise(done => requestAnimationFrame(() => done(psmpc.time)))"))


def test_a_page_is_shown_in_a_notebook_and_saved_once(run: Run, tmp_path: Path) -> None:
    page = view(run)
    assert page._repr_html_().startswith("<iframe srcdoc=")
    assert page.save(tmp_path / "new" / "page.html").read_text() == page.html
    for path in (tmp_path / "new" / "page.html", tmp_path):
        with pytest.raises(InputError):
            page.save(path)
    with pytest.raises(InputError, match="at least one of them"):
        view({})


def test_a_page_has_forces_with_their_limits_or_says_what_a_run_without_limits_asks_for(
    run: Run, tmp_path: Path
) -> None:
    limited = view(there_and_back(tmp_path, *CUT, name="cut")).html
    assert "base (N, own axes)" in limited and '"label": "limit"' in limited
    assert "Largest commanded force, of its limit: base.x: 125.0 %" in limited
    free = view(run).html
    assert "base (N)" in free and '"label": "limit"' not in free
    assert "No limit of forces or accelerations is declared; the largest are: base force" in free


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_the_scene_is_drawn_and_moves_without_errors(
    browser: WebDriver, run: Run, tmp_path: Path, width: int, height: int
) -> None:
    opened(browser, {"psmpc": run, "smpc": run}, tmp_path / "page.html", width, height)
    seek(browser, 0.0)
    before = pixels(browser)
    background = np.median(before.reshape(-1, 3), axis=0)
    assert (np.abs(before - background).max(axis=2) > 30).mean() > 0.02
    seek(browser, 0.6)
    assert (np.abs(pixels(browser) - before).max(axis=2) > 30).mean() > 1e-3
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []


@pytest.mark.slow
@pytest.mark.parametrize("space", [False, True], ids=["planar", "spatial"])
def test_what_is_drawn_is_where_the_kinematics_put_it(
    browser: WebDriver, run: Run, tmp_path: Path, space: bool
) -> None:
    run = simulate(turning(120)) if space else run
    opened(browser, run, tmp_path / "page.html")
    model = run.problem.model
    for time in (0.0, 0.43, run.motion.end):
        seek(browser, time)
        Q, drawn = run.motion.coordinates_at(time), browser.execute_script("return psmpc.poses()")
        for found, frame in zip(drawn["bodies"], model.body_frames(Q), strict=True):
            assert found[:3] == pytest.approx(frame[:3, 3], abs=1e-6)
            assert Rotation.from_quat(found[3:]).as_matrix() == pytest.approx(frame[:3, :3], abs=1e-6)
        tools = np.array(drawn["tools"])[:, : model.dimension]
        assert tools == pytest.approx(model.poses(Q)[1:, : model.dimension], abs=1e-6)
        scene = scene_of(run)
        for stage in scene.acting_stages(time):
            for found, frame in zip(drawn["targets"][stage], scene.target_frames(stage, time), strict=True):
                assert found[:3] == pytest.approx(frame[:3, 3], abs=1e-5)
                assert Rotation.from_quat(found[3:]).as_matrix() == pytest.approx(frame[:3, :3], abs=1e-5)


@pytest.fixture(scope="module")
def among_obstacles(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A made-up run among obstacles."""
    return read_run(write_story(tmp_path_factory.mktemp("log") / "clear.h5", Story(**story_among_obstacles())))


def test_a_run_that_keeps_clear_has_curves_of_its_distances(among_obstacles: Run, run: Run) -> None:
    assert '"label": "distance (mm)"' in view(among_obstacles).html
    assert "distance (mm)" not in view(run).html


@pytest.mark.slow
def test_obstacles_and_the_nearest_parts_are_where_the_log_has_them(
    browser: WebDriver, among_obstacles: Run, tmp_path: Path
) -> None:
    run = among_obstacles
    opened(browser, run, tmp_path / "page.html")
    model = run.problem.model
    for time, nearest in ((0.0, "100 mm, base \N{EN DASH} wall"), (12.0, "-50 mm, base \N{EN DASH} wall")):
        seek(browser, time)
        drawn = browser.execute_script("return psmpc.poses()")
        ball, beam, crate, wall = (np.array(pose) for pose in drawn["obstacles"])
        assert ball[:3] == pytest.approx([-1 + 0.05 * time, 1.2, 0])
        for found, angle in ((beam, np.pi / 6), (crate, np.pi / 9)):
            assert Rotation.from_quat(found[3:]).as_rotvec() == pytest.approx([0, 0, angle])
        assert wall[0] < -3.2
        text, *ends = drawn["nearest"]
        assert text == nearest
        distance = float(nearest.split()[0]) / 1e3
        assert np.array(ends)[:, :3] == pytest.approx(np.array([[1, 1, 0], [1 + distance, 1, 0]]))
        assert drawn["covers"] == [None] * len(pieces_of(model.spec))
    browser.find_element(By.ID, "show-covers").click()
    browser.find_element(By.ID, "show-nearest").click()
    seek(browser, 12.0)
    drawn = browser.execute_script("return psmpc.poses()")
    assert drawn["nearest"] is None
    expected = [
        ends.mean(axis=0) for ends, _ in capsules(model, pieces_of(model.spec), run.motion.coordinates_at(12.0))
    ]
    assert np.array(drawn["covers"])[:, :3] == pytest.approx(np.array(expected), abs=1e-5)
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    opened(browser, there_and_back(tmp_path, name="free"), tmp_path / "free.html")
    assert not any(browser.find_element(By.ID, name).is_displayed() for name in ("show-covers", "show-nearest"))


@pytest.mark.slow
def test_keys_pointer_and_play_move_the_time(browser: WebDriver, run: Run, tmp_path: Path) -> None:
    opened(browser, run, tmp_path / "page.html")
    line, body = browser.find_element(By.ID, "timeline"), browser.find_element(By.TAG_NAME, "body")
    ActionChains(browser).click(line).perform()
    assert time_of(browser) == pytest.approx(run.motion.end / 2, abs=0.02)
    body.send_keys(Keys.HOME, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert time_of(browser) == pytest.approx(run.time[1])
    assert line.get_attribute("aria-valuenow") == f"{run.time[1]:.2f}"
    body.send_keys(Keys.END)
    assert time_of(browser) == pytest.approx(run.motion.end)
    browser.execute_script("document.getElementById('speed').options[0].value = '0.01'; speed.selectedIndex = 0")
    body.send_keys(Keys.HOME, Keys.SPACE)
    assert browser.find_element(By.ID, "play").get_attribute("aria-label") == "pause"
    assert time_of(browser) < run.motion.end
    body.send_keys(Keys.SPACE)
    stopped = time_of(browser)
    assert time_of(browser) == stopped > 0
    for tab in browser.find_elements(By.CSS_SELECTOR, "#tabs button"):
        name = tab.text
        tab.click()
        chosen = browser.find_element(By.CSS_SELECTOR, "#tabs [aria-selected=true]")
        assert chosen.text == name
        assert browser.find_elements(By.CSS_SELECTOR, "#panels .uplot")


def touch(browser: WebDriver, *fingers: list[tuple[float, float]]) -> None:
    """Put fingers down where each way (x, y) [px] begins, move them along their ways at once, and lift them."""

    def send(kind: str, points: list[tuple[float, float]]) -> None:
        given = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": given})

    first, *others = zip(*fingers, strict=True)
    send("touchStart", list(first))
    for points in others:
        send("touchMove", list(points))
    send("touchEnd", [])


def box(browser: WebDriver, selector: str) -> tuple[float, float, float, float]:
    """Left, top, width and height of an element in the window [px]."""
    script = (
        "const b = document.querySelector(arguments[0]).getBoundingClientRect(); return [b.x, b.y, b.width, b.height]"
    )
    x, y, width, height = browser.execute_script(script, selector)
    return x, y, width, height


@pytest.mark.slow
def test_fingers_scrub_turn_and_zoom_on_a_small_screen(browser: WebDriver, run: Run, tmp_path: Path) -> None:
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
    opened(browser, run, tmp_path / "page.html", *SIZES[0])
    x, y, width, height = box(browser, "#timeline")
    touch(browser, [(x + 0.2 * width, y + height / 2), (x + 0.5 * width, y + height / 2), (x + 0.75 * width, y)])
    assert time_of(browser) == pytest.approx(0.75 * run.motion.end, abs=0.01)
    x, y, width, height = box(browser, "#panels .u-over")
    touch(browser, [(x + 0.1 * width, y + 5), (x + 0.4 * width, y + 5)])
    assert time_of(browser) == pytest.approx(0.4 * run.motion.end, abs=0.02)
    x, y, width, height = box(browser, "#canvas")
    middle, seen = (x + width / 2, y + height / 2), [browser.execute_script("return psmpc.camera()")]
    touch(browser, [middle, (middle[0], middle[1] - 40), (middle[0] + 60, middle[1] - 80)])
    seen.append(browser.execute_script("return psmpc.camera()"))
    touch(browser, *[[(middle[0] + side * gap, middle[1]) for gap in (20, 40, 80)] for side in (-1, 1)])
    seen.append(browser.execute_script("return psmpc.camera()"))
    before, turned, nearer = (np.subtract(each["position"], each["target"]) for each in seen)
    length = np.linalg.norm([before, turned, nearer], axis=1)
    assert length[1] == pytest.approx(length[0])
    assert before @ turned < 0.95 * length[0] ** 2
    assert length[2] < 0.5 * length[1]
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


@pytest.mark.slow
def test_without_webgl_a_message_stands_for_the_scene(run: Run, tmp_path: Path) -> None:
    with opened_browser(tmp_path / "profile", "--disable-3d-apis") as browser:
        opened(browser, run, tmp_path / "page.html")
        assert browser.find_element(By.ID, "no-webgl").is_displayed()
        assert browser.find_elements(By.CSS_SELECTOR, "#panels .uplot")


def lab(color: str) -> np.ndarray:
    """CIE L*a*b* of a colour, in which distances are those that one sees."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92)
    of_white = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(of_white @ linear / of_white.sum(axis=1))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_arms_joints_and_stages_have_colours_of_their_own(tmp_path: Path) -> None:
    run = read_run(write_story(tmp_path / "log.h5", Story(**story_among_obstacles())))
    (data,) = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', view(run).html, re.DOTALL)[1])
    stages = {stage["color"] for stage in data["stages"]}
    bodies = {*data["robot"]["colors"], data["robot"]["baseColor"], data["robot"]["objectColor"]}
    curves = {
        each["color"]
        for tab in data["plots"]
        if tab["name"] in ("Velocities", "Coordinates", "Controls", "Forces")
        for panel in tab["panels"]
        for each in panel["series"]
        if not each["limit"]
    }
    (of_stages,) = [tab for tab in data["plots"] if tab["name"] == "Stages"]
    assert {each["color"] for each in of_stages["panels"][0]["series"]} <= stages
    assert len(stages) == 4 and not curves & bodies
    for stage in stages:
        others = [lab(color) for color in bodies | curves]
        assert np.linalg.norm(np.array(others) - lab(stage), axis=1).min() > 15, stage
    errors = next(tab for tab in data["plots"] if tab["name"] == "Errors")["panels"][0]["series"]
    of_parts = {each["label"]: each["color"] for each in errors}
    assert [of_parts["arm 1"], of_parts["arm 2"]] == data["robot"]["colors"][1:]


def test_limits_of_one_joint_have_its_colour_on_the_page(tmp_path: Path) -> None:
    html = view(there_and_back(tmp_path, *CUT, name="cut")).html
    (data,) = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', html, re.DOTALL)[1])
    forces = next(tab for tab in data["plots"] if tab["name"] == "Forces")["panels"][0]["series"]
    x = next(each for each in forces if each["label"] == "x")
    assert {each["color"] for each in forces if each["limit"]} == {x["color"]}


@pytest.mark.slow
def test_labels_cover_neither_the_robot_nor_each_other(browser: WebDriver, tmp_path: Path) -> None:
    run = read_run(write_story(tmp_path / "log.h5", Story(**story_among_obstacles())))
    opened(browser, run, tmp_path / "page.html")
    box = browser.execute_script("return document.getElementById('canvas').getBoundingClientRect().toJSON()")
    for time in (2.0, 9.0, 12.0, 21.0, 28.0):
        for button in ("above", "tilted"):
            browser.find_element(By.ID, button).click()
            seek(browser, time)
            labels = browser.execute_script("return psmpc.labels()")
            assert any("mm" in label["text"] for label in labels)
            poses = browser.execute_script("return psmpc.poses(0)")
            seen = on_screen(browser.execute_script("return psmpc.camera()"), box, [*poses["bodies"], *poses["tools"]])
            for label in labels:
                x, y = seen.T
                inside = (label["left"] < x) & (x < label["right"]) & (label["top"] < y) & (y < label["bottom"])
                assert not inside.any(), (time, button, label["text"])
            for one, other in combinations(labels, 2):
                wide = min(one["right"], other["right"]) - max(one["left"], other["left"])
                high = min(one["bottom"], other["bottom"]) - max(one["top"], other["top"])
                assert min(wide, high) < 1, (time, one["text"], other["text"])


def on_screen(camera: dict[str, list[float]], box: dict[str, float], poses: list[list[float]]) -> np.ndarray:
    """Where the origins of poses are on the page (., 2) [px], seen by the page's camera of 30 degrees."""
    eye, target = np.array(camera["position"]), np.array(camera["target"])
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    seen = (np.array(poses)[:, :3] - eye) @ np.array([right, np.cross(back, right), back]).T
    scale = box["height"] / 2 / np.tan(np.radians(15))
    along = seen[:, :2] / -seen[:, 2:] * scale
    return np.array([box["left"] + box["width"] / 2, box["top"] + box["height"] / 2]) + along * [1, -1]


@pytest.mark.slow
@pytest.mark.parametrize(("width", "columns"), [(1400, 2), (1100, 2), (860, 1)])
def test_a_report_has_its_figures_in_so_many_columns(
    browser: WebDriver, run: Run, tmp_path: Path, width: int, columns: int
) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(report_run(run).save(tmp_path / "report.html").as_uri())
    figures = browser.find_elements(By.CSS_SELECTOR, ".gallery figure")
    assert len({figure.rect["x"] for figure in figures}) == columns
    assert min(figure.rect["width"] for figure in figures) >= 400
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width


@pytest.fixture(scope="module")
def thrusting(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A platform in front of a panel, which shuts two of its thrusters."""
    return simulate(
        before_a_panel(
            tmp_path_factory.mktemp("robot"),
            initial={"base": [0.8, 0, 0], **FOLDED},
            time_limit=1.0,
            log={"ticks": False},
        )
    )


def data_of(run: Run) -> dict[str, Any]:
    """What the page of a run draws."""
    (data,) = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', view(run).html, re.DOTALL)[1])
    return data


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(b64decode(packed["data"]), f"<{packed['type']}").reshape(packed["shape"])


def test_a_page_has_the_thrusts_of_thrusters_and_what_wheels_store(thrusting: Run, run: Run, tmp_path: Path) -> None:
    drawn = data_of(thrusting)["thrusters"]
    np.testing.assert_allclose(unpacked(drawn["share"]), thrusting["thrusters/impulse"] / 1.0, rtol=1e-6)
    np.testing.assert_allclose(unpacked(drawn["shut"]), thrusting["thrusters/shut"])
    assert unpacked(drawn["share"]).max() > 0.5 and unpacked(drawn["shut"]).max() == 1
    assert drawn["nozzles"][0] == [-0.25, 0.24, 0.0]
    assert drawn["axes"][0] == [-1.0, 0.0, 0.0]
    assert data_of(thrusting)["wheels"] is None
    turning_by_wheels = simulate(planar_in(tmp_path, {"time_limit": 0.4}))
    stored = data_of(turning_by_wheels)["wheels"]
    assert stored["axes"] == [[0.0, 0.0, 1.0]] * 2
    np.testing.assert_allclose(unpacked(stored["share"]), turning_by_wheels["wheels/momentum"] / [2.0, 3.0], rtol=1e-6)
    assert data_of(run)["thrusters"] is None and data_of(run)["wheels"] is None


@pytest.mark.slow
def test_flames_are_at_their_nozzles_and_as_long_as_the_thrusts(
    browser: WebDriver, thrusting: Run, run: Run, tmp_path: Path
) -> None:
    opened(browser, thrusting, tmp_path / "page.html")
    share, shut = thrusting["thrusters/impulse"], thrusting["thrusters/shut"]
    sample = int(share.sum(axis=1).argmax())
    seek(browser, thrusting.time[sample] + 0.05)
    flames = browser.execute_script("return psmpc.poses().flames")
    lengths = np.array([flame["length"] for flame in flames])
    assert lengths == pytest.approx(lengths.max() * share[sample] / share[sample].max())
    assert lengths.max() > 0.1
    frame = thrusting.problem.model.body_frames(thrusting.motion.coordinates_at(thrusting.time[sample] + 0.05))[0]
    thrusters = thrusting.problem.model.spec.thrusters
    for flame, thruster, is_shut in zip(flames, thrusters, shut[sample] > 0, strict=True):
        nozzle = frame @ [*thruster.position, 0.0, 1.0]
        assert flame["pose"][:3] == pytest.approx(nozzle[:3], abs=1e-6)
        along = Rotation.from_quat(flame["pose"][3:]).apply([0, 1, 0])
        pushed = frame[:3, :2] @ thruster.direction
        assert along == pytest.approx(-pushed / np.linalg.norm(pushed), abs=1e-6)
        assert (flame["color"] == 0xC01818) == is_shut
    assert browser.find_element(By.ID, "shut").is_displayed()
    assert not browser.find_element(By.ID, "wheels").is_displayed()
    browser.find_element(By.ID, "show-thrusters").click()
    seek(browser, 0.5)
    assert browser.execute_script("return psmpc.poses().flames") is None
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    opened(browser, run, tmp_path / "none.html")
    assert not any(browser.find_element(By.ID, name).is_displayed() for name in ("thrusters", "wheels"))


@pytest.mark.slow
def test_wheels_have_the_colour_of_what_they_store(browser: WebDriver, tmp_path: Path) -> None:
    """White where empty; the more of what they may store, the nearer to the colour of that way."""
    run = simulate(planar_in(tmp_path, {"time_limit": 0.4}))
    opened(browser, run, tmp_path / "page.html")
    seek(browser, 0.2)
    share = run["wheels/momentum"][2] / [2.0, 3.0]
    assert share[0] > 0 > share[1]
    drawn = browser.execute_script("return psmpc.poses().wheels")
    for wheel, part in zip(drawn, share, strict=True):
        red, green, blue = (int(wheel["color"][i : i + 2], 16) for i in (0, 2, 4))
        assert (blue > green) == (part > 0) and min(red, green, blue) < 0xF0
    assert browser.find_element(By.ID, "wheels").is_displayed()
