#pragma once

#include <cstdint>

typedef std::uint64_t hrt_abstime;

/* us since the start */
hrt_abstime hrt_absolute_time();
