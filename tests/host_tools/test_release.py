"""A release: what `make release` writes, and that nothing of it is used unless it is whole."""

import shutil
import subprocess
from pathlib import Path

import pytest

import make_release
from echowing import __version__, cli
from echowing.applets import HOLD
from echowing.errors import EchowingError
from echowing.release import SUMS, Release, firmware_file
from echowing.setup.applet import applet_path
from echowing.sim.boards.firmware import BOARDS

IMAGES = {"mega": "hex", "blackpill_f411": "bin", "bluepill_f103": "bin", "nucleo_f446": "bin"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make release` writes it, but for the firmware, which takes minutes to compile."""
    folder = tmp_path_factory.mktemp("release")
    built = {firmware_file(*image): folder / image[0] for image in IMAGES.items()}
    for name, path in built.items():
        path.write_text(f"the image {name}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(make_release, "firmware_images", lambda: built)
        return make_release.write_release(folder / "dist")


@pytest.fixture
def release(whole: Path, tmp_path: Path) -> Path:
    """One to spoil."""
    return shutil.copytree(whole, tmp_path / "release")


@pytest.fixture
def card(tmp_path: Path) -> Path:
    (tmp_path / "card" / "APM").mkdir(parents=True)
    return tmp_path / "card"


def spoil(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b" ")


def renew_sum(release: Path, name: str) -> None:
    """As if it had been built like this."""
    (release / SUMS).unlink()
    make_release.write_sums(release)
    assert name in (release / SUMS).read_text()


class TestWritten:
    def test_all_is_in_one_folder(self, whole: Path) -> None:
        assert whole.name == __version__
        assert {path.name for path in whole.iterdir()} == {
            f"echowing-{__version__}-py3-none-any.whl",
            *(f"echowing-{board}.{kind}" for board, kind in IMAGES.items()),
            *("echowing.lua", "echowing_speed.lua", "NOTES.md", "SHA256SUMS"),
        }
        assert set(IMAGES) == set(BOARDS)

    def test_the_checksums_are_those_of_coreutils(self, whole: Path) -> None:
        checked = subprocess.run(
            ["sha256sum", "--check", "--strict", SUMS],
            cwd=whole,
            capture_output=True,
            text=True,
            check=False,
        )
        assert checked.returncode == 0, checked.stderr
        assert checked.stdout.count(": OK\n") == len(list(whole.iterdir())) - 1

    def test_the_notes_are_the_changelog_s_part(self, whole: Path) -> None:
        notes = (whole / "NOTES.md").read_text()
        assert notes.startswith(f"# Echowing {__version__}\n")
        assert notes.splitlines()[-1].startswith("Built from ")
        log = "# Changelog\n\n## 2.0\n\nnew\n\n### Flight\n\nfar\n\n## 1.0\n\nold\n"
        assert make_release.notes_of(log, "2.0") == "# Echowing 2.0\n\nnew\n\n### Flight\n\nfar"
        with pytest.raises(EchowingError, match=r"no part `## 3\.0`"):
            make_release.notes_of(log, "3.0")

    def test_boards_that_cannot_be_built_are_named(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(make_release, "_made", lambda name: name == "mega")
        assert make_release.main([str(tmp_path / "dist")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(
            "error: no release: no firmware for blackpill_f411, bluepill_f103, nucleo_f446. "
        )
        assert "ECHOWING_STM32_CORE" in line
        assert not (tmp_path / "dist").exists()


class TestApplet:
    def test_comes_from_the_release(self, release: Path, card: Path) -> None:
        spoil(release / HOLD.file)
        renew_sum(release, HOLD.file)
        assert cli.main(["setup", "lua", "--mount", str(card), "--release", str(release)]) == 0
        written = (card / "APM" / "scripts" / HOLD.file).read_bytes()
        assert written == (release / HOLD.file).read_bytes() != applet_path().read_bytes()

    @pytest.mark.parametrize(
        "options", [("lua", "--mount", "CARD"), ("apply", "--vehicle", "tcp:0:1")]
    )
    def test_with_a_wrong_checksum_is_refused(
        self,
        release: Path,
        card: Path,
        options: tuple[str, ...],
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        """Before a card or a vehicle is looked for."""
        spoil(release / HOLD.file)
        where = [str(card) if option == "CARD" else option for option in options]
        assert cli.main(["setup", *where, "--release", str(release)]) == 2
        said = capsys.readouterr().err
        assert "its checksum differs" in said and "nothing is written" in said
        assert list(card.rglob("*")) == [card / "APM"]


class TestRefused:
    def test_where_there_is_none(self, tmp_path: Path) -> None:
        with pytest.raises(EchowingError, match="no release there"):
            Release(tmp_path)

    def test_sums_that_are_none(self, release: Path) -> None:
        (release / SUMS).write_text("12345  ../../etc/passwd\n")
        with pytest.raises(EchowingError, match="not as `make release` writes it"):
            Release(release)

    def test_another_version(self, release: Path) -> None:
        path = release / SUMS
        path.write_text(path.read_text().replace(f"echowing-{__version__}-", "echowing-9.9-"))
        with pytest.raises(EchowingError, match=r"this is release 9\.9, and the tools here are"):
            Release(release)

    def test_a_file_that_is_missing(self, release: Path) -> None:
        (release / HOLD.file).unlink()
        with pytest.raises(EchowingError, match=r"this release has no echowing\.lua"):
            Release(release).verified(HOLD.file)
        with pytest.raises(EchowingError, match="this release has no echowing-uno"):
            Release(release).verified("echowing-uno.hex")
