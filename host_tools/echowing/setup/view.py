"""What `echowing setup` prints: findings as lines and as JSON, changes before they are written."""

from collections.abc import Iterator, Mapping, Sequence

from echowing.mavlink.vehicle_limits import BY_NAME
from echowing.setup.applet import PARAMETER_PREFIX
from echowing.setup.apply import Change
from echowing.setup.checks import Finding, Verdict, examine, exit_code, judge, memory
from echowing.setup.readout import CardApplet, Readout, Role
from echowing.setup.settings import HEAP, LEAST_LIMITS, settings_for

_RESULTS = {0: "fine", 1: "wrong", 2: "unknown"}
_MARKS = {
    Verdict.FINE: "fine ",
    Verdict.WRONG: "WRONG",
    Verdict.YOURS: "yours",
    Verdict.UNKNOWN: "  ?  ",
}
_COUNTED = {
    Verdict.WRONG: "wrong",
    Verdict.UNKNOWN: "not checked",
    Verdict.YOURS: "yours to decide",
    Verdict.FINE: "fine",
}


def as_json(
    system_id: int, readout: Readout, findings: Sequence[Finding], role: Role = Role.FOLLOWER
) -> dict[str, object]:
    """A check's result; `verdict` of a finding is fine, wrong, yours or unknown."""
    return {
        "system_id": system_id,
        "role": role.value,
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


def as_lines(
    system_id: int, readout: Readout, findings: Sequence[Finding], role: Role = Role.FOLLOWER
) -> Iterator[str]:
    """A check's result as lines: what is not fine, why, and how to fix it."""
    firmware = "" if readout.version is None else " {}.{}".format(*readout.version)
    state = "armed" if readout.armed else "disarmed"
    yield f"vehicle {system_id}, ArduCopter{firmware}, {state}, as a {role.value}"
    wide = max((len(one.about) for one in findings), default=0)
    folded = [one for one in findings if _is_dull(one)]
    for one in findings:
        if _is_dull(one):
            continue
        yield f"{_MARKS[one.verdict]}  {one.about:<{wide}} {one.found}"
        if one.verdict is not Verdict.FINE:
            yield from (f"         {text}" for text in (one.why, one.fix) if text)
    if folded:
        about = f"{PARAMETER_PREFIX}…".ljust(wide)
        yield f"{_MARKS[Verdict.FINE]}  {about} {len(folded)} parameters within their ranges"
    verdicts = [one.verdict for one in findings]
    counts = ((verdicts.count(verdict), text) for verdict, text in _COUNTED.items())
    yield ", ".join(f"{count} {text}" for count, text in counts if count)


def _is_dull(finding: Finding) -> bool:
    """Whether it is one of the applet's many parameters, and is fine."""
    return finding.verdict is Verdict.FINE and finding.about.startswith(PARAMETER_PREFIX)


def changes_as_lines(changes: Sequence[Change]) -> Iterator[str]:
    """The changes to write."""
    for change in changes:
        later = ", used from the next start on" if change.restart else ""
        yield _row(change.name, f"{change.old:g} -> {change.new:g}{later}: {change.why}")


def tuning_note(changes: Sequence[Change]) -> list[str]:
    """What higher limits do besides following; nothing where none is raised."""
    raised = [one.name for one in changes if BY_NAME.get(one.name) in LEAST_LIMITS]
    if not raised:
        return []
    return [
        f"{', '.join(raised)}: in Auto and RTL, too, the vehicle will",
        "  speed up, brake and turn harder, and lean by 27 degrees for it, in wind by up",
        "  to 45, and with a pilot's full stick. Only for a vehicle that is tuned (AutoTune)",
        "  and strong enough. Watch its first Auto and RTL with them.",
    ]


_ON_CARD = {
    CardApplet.NONE: "not on the card -> this package's",
    CardApplet.ANOTHER: "another version on the card -> this package's",
    CardApplet.OURS: "on the card",
    CardApplet.OTHER: "the other one leaves the card",
    CardApplet.SEVERAL: "the other one leaves the card",
    None: "the card cannot be read (no answer to file requests); left alone",
}


def differences(
    readout: Readout, changes: Sequence[Change], hidden: Mapping[str, float]
) -> Iterator[str]:
    """The changes to write, and what is left as it is although it is not fine.

    hidden: values to write when the parameter exists.
    """
    yield from changes_as_lines(changes)
    for name, value in hidden.items():
        yield _row(name, f"not shown yet; -> {value:g} after the restart, if it is wrong")
    told = {change.name for change in changes} | set(hidden)
    for setting in settings_for(readout):
        found = judge(setting, readout)
        if found is not None and found.verdict is not Verdict.FINE and found.about not in told:
            yield _row(found.about, f"{found.found}, left alone: {found.why}; {found.fix}")
    for found in examine(readout):
        if found.verdict is Verdict.YOURS and found.about not in told:
            yield _row(found.about, f"{found.found} stays; it is yours to decide: {found.why}")
    room = memory(readout)
    if room.verdict is not Verdict.FINE:
        yield _row(HEAP, f"{room.found}, left alone: {room.why}; {room.fix}")
    yield _row("applet", _ON_CARD[readout.applet_on_card])
    if readout.serial_port is None:
        yield _row("SERIALn_…", "left alone: give --serial N, the port of the co-processor")


def _row(name: str, text: str) -> str:
    return f"{name:<17} {text}"
