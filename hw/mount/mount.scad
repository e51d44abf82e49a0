// Pan/tilt mount for a MaxBotix MB1202 and two micro servos, clamped to a frame tube.
//
// All numbers come from parameters.scad, which `make hw` writes from parameters.toml, from the
// firmware's scan points and reach and from the simulator's beam: edit those, not this.
//
// part = "base", "cap", "yoke" or "cradle": one printed part, lying as it is printed.
// part = "plate": all four as printed, side by side.
// part = "assembly": everything in place.
// part = "vehicle": the same on frame and propellers, with the beam's cones.
// part = "fixed", "panning", "tilting", "frame", "discs": what stands and moves together, for the
// checks; without the servos' horns and the pivot's shaft, which touch on purpose.
// part = "yoke_mass", "tilt_servo_mass", "cradle_mass", "sonar_mass": one body each, for the inertia.
// part = "none": nothing; only tells the derived measures.
// pan_deg and tilt_deg turn the assembly (left and up positive).

include <parameters.scad>

part = "assembly";
pan_deg = 0;
tilt_deg = 0;

$fn = 48;
eps = 0.01; // keeps cut faces from coinciding
bodies = ["fixed", "panning", "tilting", "frame", "discs",
          "yoke_mass", "tilt_servo_mass", "cradle_mass", "sonar_mass"];
drawn = len([for (body = bodies) if (body == part) body]) == 0; // a picture or a print, no check

// ---- derived heights and widths ---------------------------------------------------------------
shelf_top = frame_tube_diameter_mm / 2 + print_wall_mm;
yoke_bottom = shelf_top + servo_horn_top_mm - servo_ear_underside_mm - horn_recess_mm;
tilt_z = yoke_bottom + print_wall_mm + tilt_axis_above_yoke_mm;

cradle_inner = max(sonar_board_height_mm, sonar_board_width_mm) + 2;
cradle_half = cradle_inner / 2 + print_cradle_wall_mm;
// servo's ear face lies on the yoke's outer face; its horn lies in the cradle's recess
servo_gap = servo_horn_top_mm - servo_ear_underside_mm - servo_ear_thickness_mm
          - print_wall_mm - horn_recess_mm;
arm_left = cradle_half + servo_gap;      // inner face of the servo's arm, y > 0
arm_right = cradle_half + print_gap_mm;  // inner face of the pivot's arm, y < 0
arm_width = servo_body_width_mm + 2 * 5;
arm_top = tilt_axis_above_yoke_mm + print_wall_mm + 11.5;

// sonar: its face ahead of the tilt axis, its mass about on the axis
plate_back = -10;
board_back = plate_back + print_plate_mm + print_rail_mm;
face_x = board_back + sonar_face_ahead_of_back_mm;

servo_middle_x = servo_spline_from_end_mm - servo_body_length_mm / 2; // between the ears

clamp_width = frame_tube_diameter_mm + 2 * (clamp_screw_offset_mm + 5);
clamp_front = frame_tube_front_mm; // a thick tube would meet the ribs beyond it
clamp_back = clamp_front - clamp_length_mm;

// ---- small pieces -----------------------------------------------------------------------------
module horn_recess(arms) {
    // an arm's outline, pointing along +x (and -x when there are two)
    linear_extrude(horn_recess_mm + eps) for (side = arms) hull() {
        circle(d = horn_hub_diameter_mm);
        translate([side * horn_tip_radius_mm, 0]) circle(d = horn_tip_diameter_mm);
    }
}

module horn_screws(depth, arms) {
    cylinder(d = horn_screw_diameter_mm, h = depth);
    for (side = arms, radius = [0.7, 0.95])
        translate([side * radius * horn_tip_radius_mm, 0, 0])
            cylinder(d = horn_tip_screw_mm, h = depth, $fn = 24);
}

// cut-out for a servo's body with its spline axis at the origin, body towards -x, cut along z
module servo_cutout(depth) {
    length = servo_body_length_mm + servo_fit_mm;
    width = servo_body_width_mm + servo_fit_mm;
    near = servo_spline_from_end_mm + servo_fit_mm / 2;
    translate([near - length, -width / 2, 0]) cube([length, width, depth]);
    for (side = [-1, 1])
        translate([servo_middle_x + side * servo_ear_screw_pitch_mm / 2, 0, 0])
            cylinder(d = servo_ear_screw_pilot_mm, h = depth, $fn = 24);
}

// ---- printed parts, in place -------------------------------------------------------------------
// upper clamp half and the pan servo's shelf
module base() {
    shelf_front = servo_middle_x + servo_ear_length_mm / 2 + 2;
    shelf_half = servo_body_width_mm / 2 + 5;
    difference() {
        union() {
            translate([clamp_back, -clamp_width / 2, clamp_squeeze_mm / 2])
                cube([clamp_length_mm, clamp_width, shelf_top - clamp_squeeze_mm / 2]);
            // the shelf, and two ribs that carry it
            translate([clamp_front - eps, -shelf_half, shelf_top - print_wall_mm])
                cube([shelf_front - clamp_front, 2 * shelf_half, print_wall_mm]);
            for (side = [-1, 1])
                translate([clamp_front - eps, side * (shelf_half - 1.5) - 1.5, 0])
                    rib(shelf_front - clamp_front);
        }
        translate([0, 0, shelf_top - print_wall_mm - eps]) servo_cutout(print_wall_mm + 2 * eps);
        tube_bore();
        clamp_screws();
    }
}

// triangular rib under the shelf, from the clamp's face forward
module rib(length) {
    rotate([90, 0, 0]) translate([0, 0, -3]) linear_extrude(3)
        polygon([[0, clamp_squeeze_mm / 2], [0, shelf_top - eps],
                 [length, shelf_top - eps], [length, shelf_top - print_wall_mm]]);
}

module cap() {
    difference() {
        translate([clamp_back, -clamp_width / 2, -shelf_top])
            cube([clamp_length_mm, clamp_width, shelf_top - clamp_squeeze_mm / 2]);
        tube_bore();
        clamp_screws();
        for (x = clamp_screw_x(), side = [-1, 1])
            translate([x, side * clamp_screw_y(), -shelf_top - eps])
                cylinder(d = print_nut_across_mm / cos(30), h = print_nut_depth_mm, $fn = 6);
    }
}

function clamp_screw_y() = frame_tube_diameter_mm / 2 + clamp_screw_offset_mm;
function clamp_screw_x() = [clamp_back + 6, clamp_front - 6];

module tube_bore() {
    translate([clamp_back - 1, 0, 0]) rotate([0, 90, 0])
        cylinder(d = frame_tube_diameter_mm, h = clamp_length_mm + 2);
}

module clamp_screws() {
    for (x = clamp_screw_x(), side = [-1, 1])
        translate([x, side * clamp_screw_y(), -shelf_top - 1])
            cylinder(d = print_screw_hole_mm, h = 2 * shelf_top + 2, $fn = 32);
}

// U on the pan servo's horn; its own origin: pan axis, underside
module yoke() {
    difference() {
        union() {
            translate([-arm_width / 2, -arm_right - print_wall_mm, 0])
                cube([arm_width, arm_right + arm_left + 2 * print_wall_mm, print_wall_mm]);
            translate([-arm_width / 2, arm_left, 0])
                cube([arm_width, print_wall_mm, arm_top]);
            translate([-arm_width / 2, -arm_right - print_wall_mm, 0])
                cube([arm_width, print_wall_mm, arm_top]);
        }
        // the horn: two arms, across, let into the underside
        translate([0, 0, -eps]) rotate(90) horn_recess([-1, 1]);
        translate([0, 0, -eps]) rotate(90) horn_screws(print_wall_mm + 1, [-1, 1]);
        // a cable tie here holds the tilt servo's lead
        for (side = [-1, 1])
            translate([-arm_width / 2 + 2, side * 4 - 1, -eps])
                cube([print_tie_width_mm, 2, print_wall_mm + 2 * eps]);
        // tilt servo from outside, its body hanging down
        translate([0, arm_left - eps, print_wall_mm + tilt_axis_above_yoke_mm])
            rotate([-90, 0, 0]) rotate(-90) servo_cutout(print_wall_mm + 2 * eps);
        // pivot screw
        translate([0, -arm_right + 1, print_wall_mm + tilt_axis_above_yoke_mm])
            rotate([90, 0, 0]) cylinder(d = print_screw_hole_mm, h = print_wall_mm + 2, $fn = 32);
    }
}

// U that carries the sonar; its own origin: on the tilt axis, looking along +x
module cradle() {
    top = horn_tip_radius_mm + horn_tip_diameter_mm / 2 + 2;
    bottom = -(sonar_hole_pitch_height_mm / 2 + print_rail_width_mm / 2);
    front = horn_hub_diameter_mm / 2 + 3;
    height = top - bottom;
    difference() {
        union() {
            translate([plate_back, -cradle_half, bottom])
                cube([print_plate_mm, 2 * cradle_half, height]);
            for (side = [-1, 1])
                translate([plate_back, side > 0 ? cradle_inner / 2 : -cradle_half, bottom])
                    cube([front - plate_back, print_cradle_wall_mm, height]);
            for (side = [-1, 1])
                translate([plate_back, -cradle_inner / 2 - eps,
                           side * sonar_hole_pitch_height_mm / 2 - print_rail_width_mm / 2])
                    cube([print_plate_mm + print_rail_mm, cradle_inner + 2 * eps,
                          print_rail_width_mm]);
        }
        // slots along the rails: either diagonal of the two-hole pattern fits
        for (side = [-1, 1], edge = [-1, 1])
            translate([plate_back - eps, edge * sonar_hole_pitch_width_mm / 2,
                       side * sonar_hole_pitch_height_mm / 2])
                rotate([0, 90, 0]) slot(print_plate_mm + print_rail_mm + 2 * eps);
        // room for the solder joints and the lead, behind the board
        translate([plate_back - eps, -cradle_inner / 2 + 3, -4])
            cube([print_plate_mm + 2 * eps, cradle_inner - 6, 8]);
        // tilt horn: one arm, up, let into the left wall's outer face
        translate([0, cradle_half + eps, 0]) rotate([90, 0, 0]) rotate(90) {
            horn_recess([1]);
            horn_screws(print_cradle_wall_mm + 1, [1]);
        }
        // pivot screw on the right, its nut inside
        translate([0, -cradle_half - eps, 0]) rotate([-90, 0, 0])
            cylinder(d = print_screw_hole_mm, h = print_cradle_wall_mm + 1, $fn = 32);
        translate([0, -cradle_inner / 2 - 1.6, 0]) rotate([-90, 0, 0])
            cylinder(d = print_nut_across_mm / cos(30), h = print_nut_depth_mm, $fn = 6);
    }
}

// slot along y, cut along z, for the sonar's screw
module slot(depth) {
    play = print_slot_play_mm / 2;
    hull() for (end = [-1, 1])
        translate([0, end * play, 0]) cylinder(d = print_screw_hole_mm, h = depth, $fn = 32);
}

// ---- things bought, for pictures and for the clash check ----------------------------------------
module servo() {
    // spline axis on z, origin at the ear's underside, body towards -x
    color("SteelBlue") translate([servo_spline_from_end_mm - servo_body_length_mm,
                                  -servo_body_width_mm / 2, -servo_ear_underside_mm])
        cube([servo_body_length_mm, servo_body_width_mm, servo_case_top_mm]);
    color("SteelBlue") translate([servo_middle_x - servo_ear_length_mm / 2,
                                  -servo_body_width_mm / 2, 0])
        cube([servo_ear_length_mm, servo_body_width_mm, servo_ear_thickness_mm]);
    color("SteelBlue") translate([0, 0, servo_case_top_mm - servo_ear_underside_mm - eps])
        cylinder(d = servo_tower_diameter_mm, h = servo_tower_top_mm - servo_case_top_mm);
    if (drawn) color("White") translate([0, 0, servo_tower_top_mm - servo_ear_underside_mm])
        cylinder(d = horn_hub_diameter_mm - 0.6,
                 h = servo_horn_top_mm - servo_tower_top_mm - horn_recess_mm);
}

// the heads of the servo's two screws, on a face at z = 0 of servo()'s frame, towards +z
module servo_screw_heads() {
    color("Silver") for (side = [-1, 1])
        translate([servo_middle_x + side * servo_ear_screw_pitch_mm / 2, 0, 0])
            cylinder(d = servo_ear_screw_head_mm, h = 1.5, $fn = 24);
}

// a screw's head or its nut with washer, on z = 0, upwards
module m3_head() { color("Silver") cylinder(d = 6.4, h = 3, $fn = 24); }

module sonar() {
    // origin: middle of the board's back, looking along +x
    color("DarkGreen") translate([0, -sonar_board_width_mm / 2, -sonar_board_height_mm / 2])
        cube([sonar_board_thickness_mm, sonar_board_width_mm, sonar_board_height_mm]);
    color("Black") translate([sonar_board_thickness_mm, 0, 0]) rotate([0, 90, 0])
        cylinder(d = sonar_transducer_diameter_mm,
                 h = sonar_face_ahead_of_back_mm - sonar_board_thickness_mm);
    color("Silver") translate([sonar_face_ahead_of_back_mm - 0.5, 0, 0]) rotate([0, 90, 0])
        cylinder(d = sonar_transducer_diameter_mm - 3, h = 0.6);
}

// ---- together -----------------------------------------------------------------------------------
module panned() { translate([0, 0, yoke_bottom]) rotate(pan_deg) children(); }
module tilted() {
    panned() translate([0, 0, tilt_z - yoke_bottom]) rotate([0, -tilt_deg, 0]) children();
}
module pan_servo() {
    translate([0, 0, shelf_top]) servo();
    translate([0, 0, shelf_top + servo_ear_thickness_mm]) servo_screw_heads();
}
module tilt_servo_frame() {
    // its ears' upper side (towards the spline) on the arm's outer face
    translate([0, arm_left + print_wall_mm + servo_ear_thickness_mm, tilt_z - yoke_bottom])
        rotate([90, 0, 0]) rotate(90) children();
}
module tilt_servo() { tilt_servo_frame() servo(); }
module tube() {
    color("DimGray") translate([frame_tube_front_mm - frame_tube_length_mm, 0, 0])
        rotate([0, 90, 0]) difference() {
            cylinder(d = frame_tube_diameter_mm, h = frame_tube_length_mm);
            translate([0, 0, -1]) cylinder(d = frame_tube_diameter_mm - 2 * frame_tube_wall_mm,
                                           h = frame_tube_length_mm + 2);
        }
}

module fixed() {
    color("Orange") base();
    color("Orange") cap();
    pan_servo();
    tube();
    for (x = clamp_screw_x(), side = [-1, 1])
        translate([x, side * clamp_screw_y(), shelf_top]) m3_head();
}
module panning() {
    color("Gold") yoke();
    tilt_servo();
    color("SaddleBrown") tilt_lead();
    // screwed through the ears from outside, the pivot's screw from the right
    tilt_servo_frame() rotate([180, 0, 0]) servo_screw_heads();
    translate([0, -arm_right - print_wall_mm, tilt_z - yoke_bottom]) rotate([90, 0, 0]) m3_head();
}
// the tilt servo's lead, from the servo's outer end round the arm to the tie on the plate
module tilt_lead() {
    r = lead_servo_diameter_mm / 2;
    lead([[-servo_body_width_mm / 2 - r, arm_left + 20, print_wall_mm + 6],
          [-arm_width / 2 - r, arm_left + 2, print_wall_mm + 5],
          [-arm_width / 2 - r, arm_left - 4, print_wall_mm + 3],
          [-arm_width / 2 + 4, 0, print_wall_mm + r - 0.2],
          [-arm_width / 2 - 0.5, 0, print_wall_mm + r - 0.2]], 2 * r);
}
module tilting() {
    color("Tomato") cradle();
    translate([board_back, 0, 0]) sonar();
    // the sonar's two screws, their heads behind the plate; the checks take either diagonal
    for (side = [-1, 1], edge = drawn ? [side] : [-1, 1])
        translate([plate_back, edge * sonar_hole_pitch_width_mm / 2,
                   side * sonar_hole_pitch_height_mm / 2]) rotate([0, -90, 0]) m3_head();
}

// a lead through its points, [x, y, z] in the mount's frame
module lead(points, d) {
    for (i = [1 : len(points) - 1]) hull() {
        translate(points[i - 1]) sphere(d = d, $fn = 10);
        translate(points[i]) sphere(d = d, $fn = 10);
    }
}
leads_mm = []; // the sonar's and the servo's at the pose, in the pictures only: these say where
module leads() if (len(leads_mm) == 2) {
    color("White") lead(leads_mm[0], lead_sonar_diameter_mm);
    color("SaddleBrown") lead(leads_mm[1], lead_servo_diameter_mm);
    color("Black") translate([lead_tie_x_mm - 1.5, -clamp_width / 2 - 1, -shelf_top - 1])
        difference() {
            cube([3, clamp_width + 2, 2 * shelf_top + 2]);
            translate([-1, 1, 1]) cube([5, clamp_width, 2 * shelf_top]);
        }
}

module assembly() {
    fixed();
    panned() panning();
    tilted() tilting();
    leads();
}

// the beam at the scan's points (green) and at the ends of the reach (blue); it starts as wide as
// the transducer
module beams() {
    for (point = scan_points_deg) color("LimeGreen", 0.10) beam(point);
    for (point = reach_ends_deg) color("DodgerBlue", 0.16) beam(point);
}
module beam(point) { // [left, up] in degrees
    start = sonar_transducer_diameter_mm / 2;
    translate([0, 0, tilt_z]) rotate(point[0]) rotate([0, -point[1], 0])
        translate([face_x, 0, 0]) rotate([0, 90, 0])
            cylinder(r1 = start, r2 = start + keepout_drawn_length_mm * tan(beam_half_angle_deg),
                     h = keepout_drawn_length_mm);
}

// the aircraft, as far as it could be in the way
module on_aircraft() { translate([face_x - frame_face_ahead_mm, 0, 0]) children(); }
module frame() {
    on_aircraft() {
        corners() motors();
        for (side = [-1, 1], end = [-1, 1]) color("DimGray") {
            rod([end * 40, side * 40, frame_arm_plane_mm],
                [end * frame_motor_length_mm / 2, side * frame_motor_width_mm / 2,
                 frame_arm_plane_mm], 12);
            rod(mirrored(frame_leg_top_mm, end, side), mirrored(frame_leg_foot_mm, end, side), 10);
        }
        color("LightSlateGray")
            translate([-frame_body_front_mm, -frame_body_half_width_mm, frame_body_bottom_mm])
                cube([2 * frame_body_front_mm, 2 * frame_body_half_width_mm,
                      frame_body_top_mm - frame_body_bottom_mm]);
    }
}
module discs() { on_aircraft() corners() propellers(); }

function mirrored(point, end, side) = [end * point[0], side * point[1], point[2]];

module corners() {
    for (side = [-1, 1], end = [-1, 1])
        translate([end * frame_motor_length_mm / 2, side * frame_motor_width_mm / 2,
                   frame_arm_plane_mm]) children();
}

module motors() {
    color("DimGray") translate([0, 0, -frame_propeller_below_arm_mm])
        cylinder(d = 28, $fn = 12, h = frame_propeller_above_arm_mm + frame_propeller_below_arm_mm);
}

module propellers() {
    color("Gray", 0.5) for (z = [frame_propeller_above_arm_mm, -frame_propeller_below_arm_mm])
        translate([0, 0, z]) cylinder(d = frame_propeller_diameter_mm, h = 2, $fn = 36);
}

module rod(from, to, d) {
    hull() { translate(from) sphere(d = d, $fn = 8); translate(to) sphere(d = d, $fn = 8); }
}

// ---- as printed: flat side down, on z = 0 ---------------------------------------------------------
module printed(name) {
    if (name == "base") translate([0, 0, shelf_top]) rotate([180, 0, 0]) base();
    if (name == "cap") translate([0, 0, shelf_top]) cap();
    if (name == "yoke") yoke();
    if (name == "cradle") translate([0, 0, -plate_back]) rotate([0, -90, 0]) cradle();
}

module plate() {
    translate([0, -35, 0]) color("Orange") printed("base");
    translate([0, 35, 0]) color("Orange") printed("cap");
    translate([60, -35, 0]) color("Gold") printed("yoke");
    translate([40, 45, 0]) color("Tomato") printed("cradle");
}

// Which way the aircraft flies, in the pictures only: an arrow and its word, which faces whoever
// looks. The pictures say where.
arrow = [0, 0, 0, 60, 0.5]; // x, y, z, length, how far along it the word stands
look_deg = [0, 0, 0];
module forward() {
    length = arrow[3];
    translate([arrow[0], arrow[1], arrow[2]]) color("Black") {
        rotate([0, 90, 0]) cylinder(d = length / 16, h = length * 0.75);
        translate([length * 0.75, 0, 0]) rotate([0, 90, 0])
            cylinder(d1 = length / 5, d2 = 0, h = length / 4);
        translate([length * arrow[4], 0, 0]) rotate(look_deg)
            translate([0, length / 4, 0]) linear_extrude(length / 100)
                text("forward", size = length / 5, halign = "center");
    }
}

// millimetres: where the yoke's underside, the tilt axis, the sonar's face, the clamp's top, the
// cradle's back and the tilt servo's outer end are
echo(yoke_bottom = yoke_bottom, tilt_z = tilt_z, face_x = face_x, shelf_top = shelf_top,
     plate_back = plate_back, yoke_back = -arm_width / 2);

if (part == "assembly") { assembly(); forward(); }
else if (part == "vehicle") { assembly(); frame(); discs(); beams(); forward(); }
else if (part == "plate") plate();
else if (part == "fixed") fixed();
else if (part == "panning") translate([0, 0, yoke_bottom]) panning();
else if (part == "tilting") translate([0, 0, tilt_z]) tilting();
else if (part == "frame") frame();
else if (part == "discs") discs();
else if (part == "yoke_mass") translate([0, 0, yoke_bottom]) yoke();
else if (part == "tilt_servo_mass") translate([0, 0, yoke_bottom]) tilt_servo();
else if (part == "cradle_mass") translate([0, 0, tilt_z]) cradle();
else if (part == "sonar_mass") translate([0, 0, tilt_z]) translate([board_back, 0, 0]) sonar();
else if (part != "none") printed(part);
