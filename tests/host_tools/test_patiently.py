"""What says, during set-up, that a long step goes on: with a terminal or without."""

import subprocess

from echowing.paths import repository_root

PATIENTLY = str(repository_root() / "host_tools" / "patiently.sh")


def run(period: str, script: str) -> "subprocess.CompletedProcess[str]":
    command = [PATIENTLY, period, "knitting", "sh", "-c", script]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_line_comes_now_and_then_and_the_exit_code_is_the_commands() -> None:
    done = run("0.2", "echo chatter; sleep 1; echo wrong >&2; exit 3")
    first, *others = done.stdout.splitlines()
    assert first == "knitting"
    assert others and all(line.startswith("  … ") for line in others)
    assert (done.returncode, done.stderr) == (3, "wrong\n")


def test_a_quick_step_is_not_waited_for() -> None:
    """Nor does what counts the seconds keep the output open."""
    done = run("30", "true")
    assert (done.returncode, done.stdout, done.stderr) == (0, "knitting\n", "")
