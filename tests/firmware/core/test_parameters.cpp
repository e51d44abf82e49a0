#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <string>

#include "parameters.h"

using namespace echowing;

namespace {

uint8_t index_of(Parameter which) { return static_cast<uint8_t>(which); }

}  // namespace

TEST_CASE("defaults lie within their own limits and names differ") {
  const Parameters parameters;
  std::set<std::string> names;
  for (uint8_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo info = parameter_info(i);
    const std::string name(info.name, strnlen(info.name, kParameterNameLength));
    CAPTURE(name);
    CHECK(parameters.at(i) == info.normal);
    CHECK(Parameters().set(i, info.normal));
    CHECK(info.least <= info.most);
    CHECK(names.insert(name).second);
    CHECK(Parameters::find(name.c_str()) == i);
  }
}

TEST_CASE("limits are inclusive, beyond them nothing changes") {
  Parameters parameters;
  const uint8_t range = index_of(Parameter::kTrackRange);
  CHECK(parameters.set(range, 30));
  CHECK(parameters.set(range, 765));
  CHECK_FALSE(parameters.set(range, 766));
  CHECK_FALSE(parameters.set(range, 29));
  CHECK(parameters.at(range) == 765);
}

TEST_CASE("fractions are refused where only whole numbers make sense") {
  Parameters parameters;
  CHECK_FALSE(parameters.set(index_of(Parameter::kMissLimit), 2.5f));
  CHECK(parameters.set(index_of(Parameter::kPanScale), -9.5f));
}

TEST_CASE("what is no number is refused") {
  Parameters parameters;
  const uint8_t scale = index_of(Parameter::kPanScale);
  CHECK_FALSE(parameters.set(scale, std::nanf("")));
  CHECK_FALSE(parameters.set(scale, std::numeric_limits<float>::infinity()));
  CHECK(parameters.at(scale) == 10);
}

TEST_CASE("unknown names and indices are refused") {
  CHECK(Parameters::find("NO_SUCH") == -1);
  CHECK(Parameters::find("") == -1);
  CHECK(Parameters::find("AVG_WINDO") == -1);
  CHECK(Parameters::find("AVG_WINDOWX") == -1);
  Parameters parameters;
  CHECK_FALSE(parameters.set(kParameterCount, 1));
}
