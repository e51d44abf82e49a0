"""Carries out `setup apply` and `setup restore`: write, restart, wait, until everything is set.

Some parameters exist only after a restart (those behind a sensor's TYPE, scripting, the applet), so
a new vehicle takes two rounds. The old values of both are in one file.
"""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from echowing.applets import HOLD, Applet, identify
from echowing.errors import EchowingError
from echowing.paths import SHIPPED_SONAR
from echowing.setup.applet import CARD_SCRIPTS, install_over_link, scripts_folder
from echowing.setup.apply import (
    Change,
    Outcome,
    Saved,
    changes_for,
    hidden_for,
    others_of,
    save,
    write_all,
)
from echowing.setup.checks import Verdict, memory
from echowing.setup.ftp import FtpClient, Progress
from echowing.setup.reading import applet_on_card, objections, read_parameters, version_and_board
from echowing.setup.readout import CardApplet, Readout
from echowing.setup.restart import (
    restart_autopilot,
    restart_scripts,
    scripting_error,
    until_applet_runs,
)
from echowing.setup.vehicle import Vehicle
from echowing.setup.view import changes_as_lines, differences, tuning_note
from echowing.sonar_file import SonarFile, load_sonar

WRITING = "parameters are written"
# Scripting, then the parameters behind it, then those behind these; one to spare.
ROUNDS = 4
INTERRUPTED_EXIT = 130

Ask = Callable[[str], bool]
Bar = Callable[[str], Progress]


@dataclass(frozen=True, slots=True)
class Plan:
    """What one round does. upload: the applet onto the card; start: it must still be loaded."""

    readout: Readout
    changes: Sequence[Change]
    upload: bool
    start: bool

    @property
    def empty(self) -> bool:
        """Whether there is nothing to do."""
        return not (self.changes or self.upload or self.start)

    @property
    def waits_for_restart(self) -> list[str]:
        """Parameters that take effect from the next start on."""
        return [change.name for change in self.changes if change.restart]


@dataclass(slots=True)
class Work:
    """What both jobs need: the vehicle, how a command line reaches it, and who gets messages.

    restart: the autopilot may be restarted. bar: makes a progress bar with a title.
    """

    vehicle: Vehicle
    where: str
    say: Callable[[str], None]
    restart: bool

    def write(self, values: Sequence[tuple[str, float]], way_back: str) -> Outcome | None:
        """Write; if that is interrupted or fails, say how to go back. None: interrupted."""

        def one(name: str, value: float) -> float:
            self.vehicle.refuse_armed(WRITING)
            return self.vehicle.write(name, value)

        count = 0

        def progress(name: str) -> None:
            nonlocal count
            count += 1
            self.say(f"writing {count} of {len(values)}: {name}")

        try:
            outcome = write_all(values, one, progress)
        except EchowingError as error:
            raise EchowingError(f"{error}\nonly some values are written; {way_back}") from error
        except KeyboardInterrupt:
            self.say(f"interrupted; only some values are written; {way_back}")
            return None
        for name, now in outcome.refused.items():
            wanted = dict(values)[name]
            self.say(
                f"{name} is {now:g} after writing {wanted:g}: the autopilot does not accept it"
            )
        self.say(f"{len(outcome.written)} of {len(values)} written and read back")
        return outcome

    def restart_now(self) -> bool:
        """Restart the autopilot and wait for it; False: restart it by hand."""
        self.say("the autopilot restarts …")
        if restart_autopilot(self.vehicle):
            self.say("it has restarted")
            return True
        self.say("it does not restart by command: switch its power off and on")
        return False


@dataclass(slots=True)
class Apply:
    """Makes a follower ready.

    ask: whether to continue; folder: of the scripts, None: find it; replace: whether the other
    applet may leave the card. sonar: as its file said when the job began; sonar_name: that file, if
    the operator has named one: only then the applet is told what it says. Without, a value that is
    not the shipped sonar's is the pilot's. release: the folder that the applet is from.
    """

    work: Work
    ask: Ask
    bar: Bar
    file: Path
    serial_port: int | None = None
    rangefinder: int = 1
    sonar: SonarFile = field(default_factory=lambda: load_sonar(SHIPPED_SONAR))
    sonar_name: str | None = None
    folder: str | None = None
    applet: Applet = HOLD
    release: Path | None = None
    replace: bool = False
    board_id: int | None = None
    now: Callable[[], datetime] = datetime.now
    _refused: set[str] = field(default_factory=set)
    _announced: set[str] = field(default_factory=set)

    def run(self) -> int:
        """0: everything is set; 1: not everything, the reason was reported; 130: interrupted."""
        self.work.vehicle.refuse_armed(WRITING)
        _, self.board_id = version_and_board(self.work.vehicle)
        plan = self._plan()
        self._refuse(plan.readout)
        self._show(plan)
        if plan.empty:
            self.work.say("nothing to write")
            return 0
        if not self.ask(f"Write these to {self.work.vehicle.name}? [y/N] "):
            self.work.say("nothing was changed")
            return 1
        self.work.vehicle.look_again()  # the operator may have taken a while to answer
        for _ in range(ROUNDS):
            code = self._carry_out(plan)
            if code is not None:
                return code
            plan = self._plan()
            if plan.empty:
                break
            if not self._agreed_again(plan):
                return 1
        return self._end(plan)

    def _refuse(self, readout: Readout) -> None:
        """Raise EchowingError where the applet cannot run, or another one is in its place."""
        room = memory(readout)
        if room.verdict is Verdict.WRONG and readout.board is not None:
            raise EchowingError(f"{room.found}; {room.why}. {room.fix}; nothing was changed")
        crowded = readout.applet_on_card in (CardApplet.OTHER, CardApplet.SEVERAL)
        if crowded and not self.replace:
            raise EchowingError(
                f"another applet than {self.applet.file} is on the card, and a vehicle runs one: "
                "give --replace to take it off; nothing was changed"
            )

    def _plan(self) -> Plan:
        vehicle = self.work.vehicle
        parameters = read_parameters(vehicle, self.serial_port, self.rangefinder)
        card = applet_on_card(vehicle, self.applet, self.folder)
        readout = Readout(
            parameters,
            serial_port=self.serial_port,
            rangefinder=self.rangefinder,
            range_type=self.sonar.rangefinder_type,
            applet_on_card=card,
            applet=self.applet,
            sonar=self.sonar.belief(),
            sonar_named=self.sonar_name is not None,
            board_id=self.board_id,
        )
        changes = [one for one in changes_for(readout) if one.name not in self._refused]
        upload = card not in (CardApplet.OURS, None)
        idle = identify(parameters) != self.applet and parameters.get("SCR_ENABLE") == 1.0
        return Plan(readout, changes, upload, idle and card is CardApplet.OURS)

    def _show(self, plan: Plan) -> None:
        hidden = hidden_for(plan.readout)
        self._announced |= set(hidden) | {change.name for change in plan.changes}
        for line in (*differences(plan.readout, plan.changes, hidden), *tuning_note(plan.changes)):
            self.work.say(line)

    def _agreed_again(self, plan: Plan) -> bool:
        """Announced changes are written without another question."""
        news = [change for change in plan.changes if change.name not in self._announced]
        for line in (*changes_as_lines(plan.changes), *tuning_note(news)):
            self.work.say(line)
        return not news or self.ask(f"Write these too to {self.work.vehicle.name}? [y/N] ")

    def _carry_out(self, plan: Plan) -> int | None:
        """One round; an exit code if it is the last one."""
        vehicle, say = self.work.vehicle, self.work.say
        vehicle.refuse_armed(WRITING)
        if plan.changes:
            save(self.file, vehicle.system_id, plan.changes, self.now())
            say(f"old values: {self.file}")
            values = [(change.name, change.new) for change in plan.changes]
            outcome = self.work.write(values, self._way_back)
            if outcome is None:
                return INTERRUPTED_EXIT
            self._refused |= set(outcome.refused)
        if plan.upload and not self._uploaded(may_wait="SCR_ENABLE" in plan.waits_for_restart):
            self.work.say("no folder for scripts yet: the autopilot makes it when scripting starts")
        return self._take_effect(plan)

    @property
    def _way_back(self) -> str:
        file = shlex.quote(str(self.file))
        return f"back: echowing setup restore {file} --vehicle {self.work.where}"

    @property
    def _same(self) -> str:
        """Options of the next command, check or apply, that are those of this one."""
        return _options(
            serial=self.serial_port,
            rangefinder=None if self.rangefinder == 1 else self.rangefinder,
            sonar=self.sonar_name,
            applet=None if self.applet == HOLD else self.applet.name,
        )

    @property
    def _same_apply(self) -> str:
        """Options of the same apply once more."""
        replace = " --replace" if self.replace else ""
        return self._same + replace + _options(release=self.release, folder=self.folder)

    def _uploaded(self, *, may_wait: bool) -> bool:
        """Copy the applet to the card; False: the next round must do it, there is no folder yet."""
        card = FtpClient(self.work.vehicle)
        try:
            folder = self.folder or scripts_folder(card)
            if folder is None and may_wait:
                return False
            install_over_link(
                card, self.bar, folder or CARD_SCRIPTS, self.applet, replace=self.replace
            )
        except EchowingError as error:
            raise EchowingError(
                f"{error}\nthe applet is not on the card: echowing setup lua --mount DIR writes it "
                f"with the card in this computer, then apply once more; {self._way_back}"
            ) from error
        self.work.say(f"{folder}/{self.applet.file}: written, read back")
        return True

    def _take_effect(self, plan: Plan) -> int | None:
        """Restart what is necessary, and wait for the applet; an exit code if the job ends here."""
        names = plan.waits_for_restart
        if not (names or plan.upload or plan.start):
            return None
        if not self._reload(names):
            return self._by_hand(names)
        if not self._applet_comes() or self._applet_runs():
            return None
        if not self.work.restart:
            return self._by_hand(names)
        self.work.say(self._way_back)
        return 1

    def _reload(self, names: Sequence[str]) -> bool:
        """Make the written values take effect; False: restart the autopilot by hand."""
        if self.work.restart:
            return self.work.restart_now()
        return not names and restart_scripts(self.work.vehicle)

    def _applet_comes(self) -> bool:
        """Whether the applet should run now."""
        scripting = self.work.vehicle.read(["SCR_ENABLE"]).get("SCR_ENABLE") == 1.0
        return scripting and (
            applet_on_card(self.work.vehicle, self.applet, self.folder) is CardApplet.OURS
        )

    def _applet_runs(self) -> bool:
        vehicle = self.work.vehicle
        self.work.say("waiting for the applet …")
        if until_applet_runs(vehicle):
            self.work.say("the applet runs")
            return True
        reason = scripting_error(objections(vehicle)) or "the autopilot reports no error"
        self.work.say(f"the applet does not run: {reason}")
        return False

    def _by_hand(self, names: Sequence[str]) -> int:
        count = f": {', '.join(names)} take effect only then" if names else ""
        self.work.say(f"restart the autopilot{count}")
        self.work.say(
            f"then: echowing setup apply --vehicle {self.work.where}{self._same_apply} --save "
            f"{shlex.quote(str(self.file))} writes the rest, its old values into the same file"
        )
        self.work.say(self._way_back)
        return 1 if self._refused else 0

    def _end(self, plan: Plan) -> int:
        if self.file.exists():
            self.work.say(self._way_back)
        if self._refused or not plan.empty:
            left = sorted(self._refused | {change.name for change in plan.changes})
            self.work.say(f"not set: {', '.join(left) or 'the applet'}")
            return 1
        check = f"echowing setup check --vehicle {self.work.where}{self._same}"
        self.work.say(f"all is set; next: {check}")
        return 0


def _options(**values: object) -> str:
    """Options of a command line; of those that are None nothing."""
    given = [(name, value) for name, value in values.items() if value is not None]
    return "".join(f" --{name} {shlex.quote(str(value))}" for name, value in given)


def restore(work: Work, file: Path, saved: Saved) -> int:
    """Write back the values of a file. 0: all; 1: some could not be; 130: interrupted."""
    vehicle = work.vehicle
    if vehicle.system_id != saved.system_id:
        raise EchowingError(
            f"{file} is of vehicle {saved.system_id}, and this is {vehicle.name}; nothing was "
            "changed"
        )
    vehicle.refuse_armed(WRITING)
    there = vehicle.read(list(saved.parameters))
    # In reverse: a sensor's TYPE goes last, because its other parameters may disappear with it.
    values = [one for one in list(saved.parameters.items())[::-1] if one[0] in there]
    absent = [name for name in saved.parameters if name not in there]
    again = f"once more: echowing setup restore {shlex.quote(str(file))} --vehicle {work.where}"
    outcome = work.write(values, again)
    if outcome is None:
        return INTERRUPTED_EXIT
    if absent:
        work.say(f"left out, as the vehicle does not have them now: {', '.join(absent)}")
    _tell_of_others(work, file, saved)
    if work.restart:
        work.restart_now()
    else:
        work.say("restart the autopilot: some of them take effect only then")
    return 1 if outcome.refused or absent else 0


def _tell_of_others(work: Work, file: Path, saved: Saved) -> None:
    """Report files of other `apply`s: they are restored from the newest to the oldest."""
    others = others_of(file, saved.system_id)
    if not others:
        return
    newer = [path for path, when in others if when > saved.when]
    older = [path for path, when in others if when <= saved.when]
    if older:
        work.say(f"from an earlier apply, restore next: {', '.join(map(str, older))}")
    if newer:
        work.say(
            f"of a later apply, to be restored before {file}: {', '.join(map(str, newer))}; if "
            f"you have not done that, do it now and then restore {file} again"
        )
