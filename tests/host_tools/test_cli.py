import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from echowing import __version__
from echowing.cli import VERBS, main
from echowing.mavlink.connection import CONN
from echowing.paths import repository_root


def test_the_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])

    assert stopped.value.code == 0
    assert capsys.readouterr().out.strip() == f"echowing {__version__}"


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_helps_with_an_example(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([verb, "--help"])

    assert stopped.value.code == 0
    assert f"  echowing {verb}" in capsys.readouterr().out


def test_help_lists_the_verbs_without_importing_what_they_need() -> None:
    code = (
        "import sys\nfrom echowing.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "print([m for m in ('numpy', 'pymavlink', 'plotly', 'pydantic', 'rich', 'lupa') "
        "if m in sys.modules])"
    )

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert all(verb in done.stdout for verb in VERBS)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["sim", "grey"], "no scenario 'grey'"),
        (
            ["sim", "--set", "gps.sigma=1"],
            "gps.sigma: no such key; allowed here: follows_s, height_follows_s, ",
        ),
        (["sim", "--seed", "many"], "--seed 'many': give a whole number"),
        (["sim", "--seed", "5-1"], "the range is empty"),
        (["sim", "absent.toml"], "absent.toml: cannot read the scenario"),
        (["calibrate", "absent-folder"], "absent-folder"),
        (["analyze", "absent.tlog", "absent2.tlog"], "absent.tlog"),
    ],
)
def test_a_users_mistake_is_one_clear_message_and_exit_code_2(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(arguments)

    shown = capsys.readouterr().err
    assert code == 2
    assert says in shown
    assert "Traceback" not in shown


def test_scenarios_are_listed_as_text_and_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "--list"]) == 0
    text = capsys.readouterr().out
    assert main(["sim", "--list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)

    assert set(listed) >= {"gray", "thesis", "echowing", "hostile"}
    assert all(name in text and title in text for name, title in listed.items())


def test_out_that_cannot_be_written_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("x")

    assert main(["sim", "gray", "--duration", "30", "--out", str(in_the_way)]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["emulator", "--elf", "/no/elf"], "--elf /no/elf: no such file"),
        (["sim", "--duration", "5", "--seed", "-3"], "--seed '-3': give a whole number"),
        (["sim", "hostile", "--duration", "5"], "duration_s (5) must be more than settle_s (10)"),
        (["analyze", "x.BIN", "y.BIN", "--radius", "-3"], "--radius -3: give 0.1 to 1000"),
        (["analyze", "x.BIN", "y.BIN", "--settle", "-5"], "--settle -5: give 0 to 86400"),
        (["analyze", "x.BIN", "y.BIN", "--settle", "nan"], "--settle nan: give 0"),
    ],
)
def test_what_is_wrong_is_named_and_not_something_else(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert reason in said.err
    assert said.out == ""


def test_a_wrong_truth_is_told_before_any_figure(capsys: pytest.CaptureFixture[str]) -> None:
    data = repository_root() / "tests" / "host_tools" / "data"
    logs = [str(data / name) for name in ("leader.BIN", "follower.BIN")]
    assert main(["analyze", *logs, "--truth", str(repository_root() / "README.md")]) == 2
    said = capsys.readouterr()
    assert "needs the columns" in said.err
    assert said.out == ""


@pytest.mark.parametrize(
    "words",
    [
        ["follow"],
        ["leader"],
        ["relay"],
        ["rig"],
        *(["setup", part] for part in ("check", "apply", "restore", "lua")),
    ],
)
def test_a_connection_has_one_name_and_one_description(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert " CONN" in told
    assert CONN in told.replace("- ", "-")


def completed(line: str, folder: Path) -> list[str]:
    """What the shell would offer at the end of a command line."""
    answer = folder / "answer"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "IFS": "\n"}
    asked |= {"_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    subprocess.run([sys.executable, "-m", "echowing"], env={**os.environ, **asked}, check=True)
    return [word.strip() for word in answer.read_text().splitlines()]


def test_the_shell_completes_verbs_options_and_choices(tmp_path: Path) -> None:
    assert set(completed("echowing ", tmp_path)) >= set(VERBS)
    assert completed("echowing follow --stop", tmp_path) == ["--stop-switch"]
    assert completed("echowing sim --law ho", tmp_path) == ["hold"]
    assert completed("echowing setup che", tmp_path) == ["check"]


@pytest.mark.parametrize("verb", ["follow", "leader", "relay", "setup", "analyze", "replay"])
def test_help_of_the_field_tools_loads_nothing_heavy(verb: str) -> None:
    """A small companion computer takes seconds for each of these."""
    code = (
        "import sys\nfrom echowing.cli import main\n"
        f"try: main(['{verb}', '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'pymap3d', 'pymavlink', 'pydantic', 'rich', 'serial'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stderr.strip() == "[]"


def test_sim_flies_a_shape_and_says_what_costs_accuracy(
    capsys: pytest.CaptureFixture[str],
) -> None:
    shape = ["--set", "formation.followers=3", "--set", "formation.spacing_m=3.5"]
    assert main(["sim", "vee", *shape, "--duration", "3", "--json"]) == 0
    said = capsys.readouterr()
    assert len(said.out.splitlines()) == 3
    assert "slots 1, 2: their sonars look at one vehicle" in said.err
