"""The Python of pages of the documentation: every line is run, block after block."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import psmpc_cli as psmpc

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "printed"),
    [
        ("python.md", "LogError"),
        ("own_loop.md", "taken at try 2"),
        ("own_robot.md", "(20, 20)"),
        ("view.md", ""),
        ("record.md", "<Run of transport under psmpc: "),
    ],
)
def test_the_page_runs(
    page: str, printed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    script = tmp_path / "page.py"
    body = "\n".join(blocks).replace("\n", "\n    ")
    script.write_text(f'if __name__ == "__main__":\n    {body}\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert printed in capsys.readouterr().out


def test_every_public_name_is_there_and_in_the_reference() -> None:
    reference = (DOCS / "api.md").read_text(encoding="utf-8").splitlines()
    for name in psmpc.__all__:
        module = getattr(psmpc, name).__module__
        assert module == "psmpc_cli.errors" or f"::: psmpc_cli.{name}" in reference
    assert set(psmpc.__all__) <= set(dir(psmpc))
    stub = Path(psmpc.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    assert set(re.findall(r" as (\w+)", stub)) == set(psmpc.__all__)
    unknown = "simulat"
    with pytest.raises(AttributeError, match="expected one of"):
        getattr(psmpc, unknown)


def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    code = "import psmpc_cli, sys; print(sorted({'casadi', 'h5py', 'matplotlib', 'numpy'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "[]\n"
