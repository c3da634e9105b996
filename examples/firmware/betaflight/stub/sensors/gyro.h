/* What is used, after Betaflight src/main/sensors/gyro.h. */
#pragma once

typedef struct {
    float gyroADCf[3]; /* deg/s about x, y, z of the body, filtered */
} gyro_t;

extern gyro_t gyro;
