#include <doctest/doctest.h>

#include "scan.h"

using namespace echowing;

TEST_CASE("the search visits the twelve points of thesis Appendix A in its order") {
  const Aim appendix_a[kScanPoints] = {
      {1330, 1400}, {1330, 1500}, {1380, 1500}, {1400, 1500}, {1400, 1400}, {1380, 1400},
      {1330, 1400}, {1330, 1300}, {1380, 1300}, {1400, 1300}, {1400, 1400}, {1380, 1400},
  };
  const Parameters parameters;
  for (uint8_t i = 0; i < kScanPoints; ++i) {
    CAPTURE(i);
    CHECK(scan_point(parameters, i).pan_us == appendix_a[i].pan_us);
    CHECK(scan_point(parameters, i).tilt_us == appendix_a[i].tilt_us);
  }
}

TEST_CASE("the centre is 1380, 1400") {
  const Aim centre = scan_centre(Parameters());
  CHECK(centre.pan_us == 1380);
  CHECK(centre.tilt_us == 1400);
}

TEST_CASE("the points follow the parameters") {
  Parameters parameters;
  REQUIRE(parameters.set(static_cast<uint8_t>(Parameter::kTiltHigh), 1650));
  CHECK(scan_point(parameters, 2).tilt_us == 1650);
}

TEST_CASE("the nearest point is the first of equals") {
  const Parameters parameters;
  CHECK(nearest_scan_point(parameters, {1380, 1400}) == 5);  // visited again as number 11
  CHECK(nearest_scan_point(parameters, {1330, 1400}) == 0);  // visited again as number 6
  CHECK(nearest_scan_point(parameters, {1400, 1290}) == 9);
  CHECK(nearest_scan_point(parameters, {2200, 2200}) == 3);
}
