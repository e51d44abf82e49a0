"""The applet onto an SD card: whole or not at all, and read back."""

from pathlib import Path

import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.setup import applet
from echowing.setup.applet import applet_path, install_on_card


@pytest.fixture
def card(tmp_path: Path) -> Path:
    (tmp_path / "APM").mkdir()
    return tmp_path


def test_copies_the_applet_where_ardupilot_looks_for_scripts(card: Path) -> None:
    target = install_on_card(card)
    assert target == card / "APM" / "scripts" / "echowing.lua"
    assert target.read_bytes() == applet_path().read_bytes()
    assert [one.name for one in target.parent.iterdir()] == ["echowing.lua"]


def test_replaces_an_older_one_and_leaves_other_scripts_alone(card: Path) -> None:
    scripts = card / "APM" / "scripts"
    scripts.mkdir()
    (scripts / "echowing.lua").write_text("-- older")
    (scripts / "other.lua").write_text("-- another's")
    install_on_card(card)
    assert (scripts / "echowing.lua").read_bytes() == applet_path().read_bytes()
    assert (scripts / "other.lua").read_text() == "-- another's"


def test_the_other_applet_leaves_the_card_only_when_told_to(card: Path) -> None:
    scripts = card / "APM" / "scripts"
    scripts.mkdir()
    (scripts / "ECHOWING_SPEED.LUA").write_text("-- as a card's names may look")
    with pytest.raises(EchowingError, match=r"SPEED.LUA is on the card.* Give --replace"):
        install_on_card(card)
    assert not (scripts / "echowing.lua").exists()
    install_on_card(card, replace=True)
    assert [one.name for one in scripts.iterdir()] == ["echowing.lua"]


def test_a_card_that_gives_back_something_else_keeps_the_older_one(
    card: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripts = card / "APM" / "scripts"
    scripts.mkdir()
    (scripts / "echowing.lua").write_text("-- older")

    def lose_the_last_byte(path: Path, content: bytes) -> None:
        path.write_bytes(content[:-1])

    monkeypatch.setattr(applet, "_write_through", lose_the_last_byte)
    with pytest.raises(EchowingError, match=r"gives back .* where .* were written"):
        install_on_card(card)
    assert (scripts / "echowing.lua").read_text() == "-- older"
    assert not (scripts / "echowing.lua.new").exists()


def test_a_folder_that_is_no_card_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="no APM folder, so this is not an autopilot's card"):
        install_on_card(tmp_path)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(EchowingError, match="no such folder"):
        install_on_card(tmp_path / "missing")


def test_what_cannot_be_written_is_told(card: Path) -> None:
    (card / "APM" / "scripts").write_text("a file in the way")
    with pytest.raises(EchowingError, match=r"scripts: cannot be created"):
        install_on_card(card)


def test_a_card_that_refuses_the_file_is_told(card: Path) -> None:
    (card / "APM" / "scripts" / "echowing.lua.new").mkdir(parents=True)
    with pytest.raises(EchowingError, match=r"echowing.lua: cannot be written: .* full or write"):
        install_on_card(card)


def test_the_verb_says_what_it_has_done(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["setup", "lua", "--mount", str(card)]) == 0
    printed = capsys.readouterr().out
    assert "written and verified, checksum" in printed
    assert "SCR_ENABLE 1" in printed


def test_the_verb_names_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["setup", "lua", "--mount", str(tmp_path / "x")]) == 2
    assert "no such folder; where is the card mounted?" in capsys.readouterr().err
