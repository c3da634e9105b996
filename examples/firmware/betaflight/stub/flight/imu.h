/* What is used, after Betaflight src/main/flight/imu.h and common/maths.h. */
#pragma once

typedef struct {
    float w, x, y, z;
} quaternion_t;

extern quaternion_t imuAttitudeQuaternion; /* from body (x forward, y left, z up) to north, west, up */
