"""What `echowing setup` prints: findings as lines and as JSON, changes before they are written."""

from collections.abc import Iterator, Sequence

from echowing.applet import PARAMETER_PREFIX
from echowing.setup.apply import Change
from echowing.setup.checks import Finding, Verdict, examine, exit_code, judge
from echowing.setup.readout import Readout
from echowing.setup.settings import settings_for

_RESULTS = {0: "fine", 1: "wrong", 2: "unknown"}
_MARKS = {
    Verdict.FINE: "fine ",
    Verdict.WRONG: "WRONG",
    Verdict.YOURS: "yours",
    Verdict.UNKNOWN: "  ?  ",
}
_COUNTED = {
    Verdict.WRONG: "wrong",
    Verdict.UNKNOWN: "not to be told",
    Verdict.YOURS: "yours to decide",
    Verdict.FINE: "fine",
}


def as_json(system_id: int, readout: Readout, findings: Sequence[Finding]) -> dict[str, object]:
    """A check's result; `verdict` of a finding is fine, wrong, yours or unknown."""
    return {
        "system_id": system_id,
        "version": None if readout.version is None else "{}.{}".format(*readout.version),
        "armed": readout.armed,
        "result": _RESULTS[exit_code(findings)],
        "findings": [
            {
                "about": one.about,
                "verdict": one.verdict.value,
                "found": one.found,
                "why": one.why,
                "fix": one.fix,
            }
            for one in findings
        ],
    }


def as_lines(system_id: int, readout: Readout, findings: Sequence[Finding]) -> Iterator[str]:
    """A check's result to read: what is not fine with why, and what fixes it."""
    firmware = "" if readout.version is None else " {}.{}".format(*readout.version)
    yield f"vehicle {system_id}, ArduCopter{firmware}, {'armed' if readout.armed else 'disarmed'}"
    folded = [one for one in findings if _is_dull(one)]
    for one in findings:
        if _is_dull(one):
            continue
        yield f"{_MARKS[one.verdict]}  {one.about:<22} {one.found}"
        if one.verdict is not Verdict.FINE:
            yield from (f"         {text}" for text in (one.why, one.fix) if text)
    if folded:
        about = f"{PARAMETER_PREFIX}…"
        yield f"{_MARKS[Verdict.FINE]}  {about:<22} {len(folded)} parameters within their ranges"
    verdicts = [one.verdict for one in findings]
    counts = ((verdicts.count(verdict), text) for verdict, text in _COUNTED.items())
    yield ", ".join(f"{count} {text}" for count, text in counts if count)


def _is_dull(finding: Finding) -> bool:
    """One of the applet's many parameters, with nothing wrong about it."""
    return finding.verdict is Verdict.FINE and finding.about.startswith(PARAMETER_PREFIX)


def differences(readout: Readout, changes: Sequence[Change]) -> Iterator[str]:
    """What is going to be written, and what is left alone although something may be said of it."""
    for change in changes:
        later = ", from the next start on" if change.restart else ""
        yield _row(change.name, f"{change.old:g} -> {change.new:g}{later}: {change.why}")
    written = {change.name for change in changes}
    for setting in settings_for(readout):
        found = judge(setting, readout)
        if found is not None and found.verdict is not Verdict.FINE and found.about not in written:
            yield _row(found.about, f"{found.found}, left alone: {found.why}; {found.fix}")
    for found in examine(readout):
        if found.verdict is Verdict.YOURS:
            yield _row(found.about, f"{found.found} stays, it is yours to decide: {found.why}")
    if "ECHO_ENABLE" not in readout:
        yield _row("ECHO_…", "the applet does not run yet; with it, apply once more")
    if readout.serial_port is None:
        yield _row("SERIALn_…", "left alone: say --serial N, the port of the co-processor")


def _row(name: str, text: str) -> str:
    return f"{name:<17} {text}"
