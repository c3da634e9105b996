#pragma once

#include "common/time.h"

/* where to be, in metres from where it was armed: north, west, up; heading counter-clockwise from north, rad */
typedef struct {
    float position[3];
    float velocity[3];
    float heading;
} omnidronesTarget_t;

void omnidronesMixerInit(void);

/* in place of mixTable(currentTimeUs), once in a loop of the PIDs; writeMotors() comes after it as before */
void omnidronesMixTable(timeUs_t currentTimeUs, const omnidronesTarget_t *target);
