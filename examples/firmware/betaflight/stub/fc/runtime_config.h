/* What is used, after Betaflight src/main/fc/runtime_config.h. */
#pragma once

#include <stdint.h>

typedef enum { ARMED = (1 << 0) } armingFlag_e;

extern uint8_t armingFlags;

#define ARMING_FLAG(mask) (armingFlags & (mask))
