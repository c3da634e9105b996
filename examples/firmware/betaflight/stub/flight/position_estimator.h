/* What is used, after Betaflight src/main/flight/position_estimator.h. */
#pragma once

#include <stdbool.h>

typedef struct {
    float x, y, z;
} vector3_t;

/* east, north, up; cm, cm/s; from where it was armed */
typedef struct {
    vector3_t position;
    vector3_t velocity;
    bool isValidXY;
    bool isValidZ;
} positionEstimate3d_t;

const positionEstimate3d_t *positionEstimatorGetEstimate(void);
