// Our warnings are strict; generated code is not ours.
#pragma once
#pragma GCC system_header

#include <stddef.h>

#include "../mavlink/echowing/mavlink.h"
