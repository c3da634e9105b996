/* The mixer against the exported vehicle, in a loop of 4 kHz: armed, it climbs to 1.5 m and stays; then it loses its position, and is to
 * keep height and attitude.
 *
 *     cc -std=c99 -O2 -I. -Istub main.c omnidrones_mixer.c hummingbird.c hummingbird_cascade.c -lm -o betaflight_hover */
#include "omnidrones_mixer.h"

#include "hummingbird.h"

#include "fc/runtime_config.h"
#include "flight/imu.h"
#include "flight/mixer.h"
#include "flight/position_estimator.h"
#include "sensors/gyro.h"

#include <math.h>
#include <stdio.h>

uint8_t armingFlags;
quaternion_t imuAttitudeQuaternion;
gyro_t gyro;
float motor[MAX_SUPPORTED_MOTORS];
float motor_disarmed[MAX_SUPPORTED_MOTORS];
static positionEstimate3d_t estimate;

float getMotorOutputLow(void)
{
    return 48.0f;
}

float getMotorOutputHigh(void)
{
    return 2047.0f;
}

const positionEstimate3d_t *positionEstimatorGetEstimate(void)
{
    return &estimate;
}

/* what Betaflight would say of a state of the vehicle */
static void sense(const float *state, bool position)
{
    estimate.isValidXY = position;
    estimate.isValidZ = true;
    estimate.position = (vector3_t){-100.0f * state[1], 100.0f * state[0], 100.0f * state[2]};
    estimate.velocity = (vector3_t){-100.0f * state[4], 100.0f * state[3], 100.0f * state[5]};
    imuAttitudeQuaternion = (quaternion_t){state[6], state[7], state[8], state[9]};
    for (int axis = 0; axis < 3; axis++) gyro.gyroADCf[axis] = state[10 + axis] * 57.29578f;
}

int main(void)
{
    static const int motorOfRotor[HUMMINGBIRD_INPUT_SIZE] = {3, 2, 0, 1};
    const omnidronesTarget_t target = {{0.2f, -0.3f, 1.5f}, {0.0f, 0.0f, 0.0f}, 0.5f};
    const int ticks = 6000, lost = 3000, loops = 8;
    float state[HUMMINGBIRD_STATE_SIZE] = {0.0f}, input[HUMMINGBIRD_INPUT_SIZE];
    timeUs_t now = 4294000000u; /* it wraps on the way */
    state[HUMMINGBIRD_STATE_ATTITUDE_W] = 1.0f;
    omnidronesMixerInit();
    for (int tick = 0; tick < ticks; tick++) {
        armingFlags = tick < 100 ? 0 : ARMED;
        sense(state, tick < lost);
        for (int loop = 0; loop < loops; loop++, now += 250) omnidronesMixTable(now, &target);
        for (int rotor = 0; rotor < HUMMINGBIRD_INPUT_SIZE; rotor++) {
            const float signal = (motor[motorOfRotor[rotor]] - getMotorOutputLow()) / (getMotorOutputHigh() - getMotorOutputLow());
            input[rotor] = signal > 0.0f ? 2.0f * signal * signal - 1.0f : -1.0f;
        }
        hummingbird_step(state, input, state);
        if (state[2] < 0.0f) state[2] = state[5] = 0.0f;
        if (tick + 1 != lost && tick + 1 != ticks) continue;
        const float yaw = 2.0f * atan2f(state[9], state[6]);
        printf("after %d ticks: %.3f m north, %.3f m west, %.3f m up, yaw %.3f rad\n", tick + 1, (double)state[0], (double)state[1],
               (double)state[2], (double)yaw);
        const float off = fabsf(state[0] - 0.2f) + fabsf(state[1] + 0.3f) + fabsf(state[2] - 1.5f) + fabsf(yaw - 0.5f);
        if (!(off < 0.05f)) {
            printf("%.3f m or rad away from where it should be\n", (double)off);
            return 1;
        }
    }
    return 0;
}
