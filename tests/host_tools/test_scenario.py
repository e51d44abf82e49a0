import math
from itertools import combinations
from pathlib import Path

import pytest

from echowing.cli import main
from echowing.docs.keys import PAGES, page
from echowing.errors import EchowingError
from echowing.flight.envelope import LEAST_M
from echowing.flight.formation import receivers_demand_m
from echowing.flight.guidance import GuidanceSettings
from echowing.flight.shapes import SHAPES
from echowing.paths import repository_root
from echowing.sim.flight import FormationWorld
from echowing.sim.hangar import Hangar, board_parameters
from echowing.sim.scenario import load_scenario, scenario_names


def user_file(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_every_scenario_of_the_demo_is_shipped_and_valid() -> None:
    names = scenario_names()

    assert set(names) == {
        "gray",
        "thesis",
        "echowing",
        "thesis-4m",
        "thesis-initial",
        "wall",
        "walked-leader",
        "hostile",
        "many",
        *SHAPES,
        "reshape",
        "swarm",
        "swarm-back",
        "column-back",
    }
    assert all(load_scenario(name).name == name for name in names)


@pytest.mark.parametrize("name", ["gray", "thesis", "echowing"])
def test_the_geometry_is_the_theses(name: str) -> None:
    scenario = load_scenario(name)

    assert (scenario.leader.north_m, scenario.leader.east_m) == (60.0, 40.0)
    assert (scenario.leader.speed_mps, scenario.leader.altitude_m) == (2.0, 10.0)
    assert scenario.slots()[0].radius_m == 3.0
    assert (scenario.guidance.telemetry_hz, scenario.guidance.rate_hz) == (4.0, 8.0)
    assert scenario.radio.leader.latency_s == 0.46
    assert (scenario.gps.sigma_m, scenario.gps.tau_s) == (0.8, 60.0)


@pytest.mark.parametrize("name", ["gray", "thesis"])
def test_the_theses_flights_have_none_of_our_protections(name: str) -> None:
    settings = load_scenario(name).guidance.settings()

    assert settings.lead_time_s == 1.0
    assert not (settings.predict or settings.tow_bar or settings.face_leader)
    assert settings.stale_age_s is None


def test_many_means_fifty() -> None:
    assert len(load_scenario("many").slots()) == 50


def test_the_applets_distance_is_its_slots_radius_unless_told_otherwise() -> None:
    slots = "formation.slots=[{radius_m=4.0}, {radius_m=9.0}, {radius_m=14.0, echo_dist_m=3.5}]"
    scenario = load_scenario("echowing", [slots])
    # 9 m is more than the applet accepts, and beyond the sonar.
    assert [scenario.echo_dist_m(index) for index in range(3)] == [4.0, None, 3.5]
    told = load_scenario("echowing", [slots, "applet.ECHO_DIST=2.0"])
    assert [told.echo_dist_m(index) for index in range(3)] == [None, None, 3.5]


@pytest.mark.parametrize(
    ("changes", "dist_m"), [([], 4.0), (["applet.ECHO_DIST=3.5"], 3.5), (["law=thesis"], 4.0)]
)
def test_a_follower_flies_with_that_distance(changes: list[str], dist_m: float) -> None:
    scenario = load_scenario("echowing", ["formation.slots=[{radius_m=4.0}]", *changes])
    follower = FormationWorld(scenario, Hangar(scenario, 1)).followers[0]
    assert follower.autopilot.parameters.saved["ECHO_DIST"] == dist_m


def test_a_users_file_is_taken(tmp_path: Path) -> None:
    scenario = load_scenario(user_file(tmp_path, 'title = "mine"\n[gps]\nsigma_m = 0.1\n'))

    assert scenario.name == "mine"
    assert scenario.gps.sigma_m == 0.1


def test_changes_reach_nested_keys() -> None:
    changes = ["gps.sigma_m=0.25", "guidance.lead_time_s=1.4", "law=thesis"]

    scenario = load_scenario("echowing", changes)

    assert scenario.gps.sigma_m == 0.25
    assert scenario.guidance.settings().lead_time_s == 1.4
    assert scenario.law == "thesis"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("gps.sigma=0.5", r"gps\.sigma: no such key; allowed here: .*sigma_m, spread, .*tau_s"),
        ("gps.sigma_m=-1", r"gps\.sigma_m: .*greater than or equal to 0.*got -1"),
        ("sonar.late_share=1.5", r"sonar\.late_share: .*less than or equal to 1.*got 1\.5"),
        ("gps.sigma_m=wide", r"gps\.sigma_m: .*valid number.*got 'wide'"),
        ("law=magic", r"law: give 'none', 'thesis', 'bands', 'hold' or a \.lua file .*got 'magic'"),
        ("guidance.rate_hz=50", r"guidance\.rate_hz: .*less than or equal to 20"),
        ("settle_s=300", r"duration_s \(240\) must be more than settle_s \(300\)"),
        ("leader.path=track", "path 'track' needs `track`"),
        ("gps", "write key=value"),
        ("title.x=1", "'title' is a value, not a section"),
        (
            "applet.ECHO_DETEKT=3",
            r"applet\.ECHO_DETEKT: echowing\.lua has no such parameter; .* ECHO_DETECT$",
        ),
        # A parameter of an applet that is no more.
        ("applet.ECHO_GAIN_P=0.7", r"applet\.ECHO_GAIN_P: echowing\.lua has no such parameter; "),
        ("applet.ECHO_DIST=9", r"applet\.ECHO_DIST: 9 is not accepted; give 1\.5 to 6$"),
        ("applet.ECHO_DIST=nan", r"applet\.ECHO_DIST: nan is not accepted"),
        (
            "follower.parameters.WP_SDP=1",
            r"follower\.parameters\.WP_SDP: the simulated ArduCopter 4\.8 has .* WP_SPD$",
        ),
        ("follower.parameters.FOO=1", r"follower\.parameters\.FOO: .* has no such parameter$"),
        ("follower.parameters.WPNAV_SPEED=500", r"ArduCopter 4\.8 has no such parameter"),
        ("follower.parameters.WP_YAW_BEHAVIOR=128", r"give -128 to 127$"),
        ("follower.parameters.ECHO_DIST=9", r"9 is not accepted; give 1\.5 to 6$"),
        ("nonsense=1", r"nonsense: no such key; allowed here: .*duration_s"),
    ],
)
def test_a_wrong_change_names_itself_and_what_is_allowed(change: str, says: str) -> None:
    with pytest.raises(EchowingError, match=says):
        load_scenario("echowing", [change])


def test_parameters_that_the_devices_have_are_taken() -> None:
    changes = [
        "applet.ECHO_DIST=4",
        'follower.generation="4.6"',
        "follower.parameters.WPNAV_SPEED=500",
        "follower.parameters.ECHO_DETECT=4",
    ]
    scenario = load_scenario("echowing", changes)
    assert scenario.follower.parameters == {"WPNAV_SPEED": 500.0, "ECHO_DETECT": 4.0}


def test_applet_and_co_processor_are_told_how_far_their_sonar_reaches() -> None:
    def limits(*changes: str) -> tuple[float | None, float | None, float]:
        scenario = load_scenario("echowing", changes)
        told = Hangar(scenario, 1)._parameters(0, 5.0)
        track_cm = board_parameters(2, scenario)["TRACK_RANGE"]
        return told.get("ECHO_DETECT"), told.get("ECHO_INSET"), track_cm

    assert limits() == (4.5, 0.2, 450.0)
    assert limits("sonar.file=lidar") == (7.5, 0.2, 750.0)
    assert limits("sonar.file=mb1202-boom") == (4.5, 0.45, 450.0)
    mine = "sonar.file=lidar", "applet.ECHO_DETECT=3", "coprocessor.TRACK_RANGE=310"
    assert limits(*mine, "applet.ECHO_INSET=0.3") == (3.0, 0.3, 310.0)


def test_a_wrong_parameter_ends_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "echowing", "--set", "applet.ECHO_DIST=9"]) != 0
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "ECHO_DIST" in line


def test_a_wrong_key_in_a_list_names_its_place(tmp_path: Path) -> None:
    text = 'title = "x"\n[formation]\nslots = [{ radius_m = 3.0, angle = 5.0 }]\n'

    with pytest.raises(EchowingError, match=r"formation\.slots\.0\.angle: no such key.*angle_deg"):
        load_scenario(user_file(tmp_path, text))


def test_slots_too_near_each_other_are_refused(tmp_path: Path) -> None:
    text = 'title = "x"\n[formation]\nslots = [{ radius_m = 3.0 }, { radius_m = 3.5 }]\n'

    with pytest.raises(EchowingError, match=r"slots 1 and 2 are 0\.50 m apart"):
        load_scenario(user_file(tmp_path, text))


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(EchowingError, match=r"no scenario 'grey'; there are .*gray"):
        load_scenario("grey")


def test_a_missing_file_and_broken_toml_are_named(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match=r"absent\.toml: cannot read"):
        load_scenario(str(tmp_path / "absent.toml"))
    with pytest.raises(EchowingError, match=r"mine\.toml: not valid TOML"):
        load_scenario(user_file(tmp_path, "title = \n"))


def test_a_scenario_without_keys_flies_as_echowing_does(tmp_path: Path) -> None:
    """What was tuned is the default, also beside a key that is given."""
    bare = load_scenario(user_file(tmp_path, 'title = "mine"\n'))
    ours = load_scenario("echowing")
    assert bare.model_dump(exclude={"name", "title"}) == ours.model_dump(exclude={"name", "title"})
    assert bare.guidance.settings() == GuidanceSettings()
    lossy = load_scenario(user_file(tmp_path, 'title = "mine"\n[radio.leader]\nloss = 0.1\n'))
    assert lossy.radio.leader.latency_s == ours.radio.leader.latency_s


def test_grays_points_lead_by_a_second_where_the_scenario_does_not_say() -> None:
    guidance = load_scenario("echowing", ["guidance.gray=true", "law=none"]).guidance
    assert guidance.settings().lead_time_s == 1.0


@pytest.mark.parametrize("name", PAGES)
def test_the_pages_of_keys_are_current(name: str) -> None:
    committed = repository_root() / "host_tools" / name
    assert committed.read_text(encoding="utf-8") == page(name), "run `make pages`"


def test_the_page_names_every_key_with_its_default() -> None:
    text = page("SCENARIOS.md")
    assert "| `sigma_m` | number ≥ 0 | 0.8 |" in text
    assert "## `[[leader.script]]`" in text
    assert "| `latency_s` | number ≥ 0 | 0.46 |" in text
    assert "| `latency_s` | number ≥ 0 | 0.05 |" in text


@pytest.mark.parametrize(
    ("law", "file", "velocity"),
    [
        ("hold", "echowing.lua", True),
        ("thesis", "echowing_speed.lua", False),
        ("bands", "echowing_speed.lua", False),
    ],
)
def test_the_law_picks_the_applet_and_its_points(law: str, file: str, velocity: bool) -> None:
    scenario = load_scenario("echowing", [f"law={law}"])
    assert scenario.applet_file is not None
    assert scenario.applet_file.name == file
    assert scenario.guidance_settings().feed_forward is velocity


def test_without_a_law_there_is_no_applet() -> None:
    scenario = load_scenario("gray")
    assert scenario.applet_file is None
    with pytest.raises(EchowingError, match="no applet, and it has no such parameter"):
        load_scenario("gray", ["applet.ECHO_DIST=3"])


@pytest.mark.parametrize("name", ["gray", "thesis", "wall", "walked-leader"])
def test_the_hold_needs_points_with_a_velocity(name: str) -> None:
    with pytest.raises(EchowingError, match="the hold needs points with a velocity"):
        load_scenario(name, ["law=hold"])


def test_a_law_has_its_own_parameters() -> None:
    assert load_scenario("thesis", ["applet.ECHO_PERIOD=0.3"]).applet == {"ECHO_PERIOD": 0.3}
    with pytest.raises(EchowingError, match=r"echowing_speed\.lua has no such parameter"):
        load_scenario("thesis", ["applet.ECHO_TAU=0.3"])


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_starts_further_apart_than_receivers_alone_demand(name: str) -> None:
    """3 m apart, all opened up at once before any sonar heard: two came to 0.68 m."""
    scenario = load_scenario(name, [])
    world = FormationWorld(scenario, Hangar(scenario, 1))
    places_m = [one.position_ned_m for one in world.followers]
    apart_m = min(math.dist(*pair) for pair in combinations(places_m, 2))
    assert apart_m > receivers_demand_m(LEAST_M) + 2.0
