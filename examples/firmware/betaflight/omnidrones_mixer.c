/* An exported controller in Betaflight, in place of its PIDs and of mixTable.
 *
 * Names, frames and units are those of Betaflight's main branch of 2026. What it has, and has not:
 * - Attitude and rates, always: imuAttitudeQuaternion (until 4.5 static, behind getQuaternion) and gyro.gyroADCf. Its frames are ours:
 *   body x forward, y left, z up, world x north, y west, z up; rates are in degrees per second. Without a magnetometer or GPS "north" is
 *   where the nose pointed at power-up, and it drifts.
 * - Height: from barometer, GPS or range finder.
 * - Position: none by default. Releases up to 2025.12 know latitude and longitude of a GPS at 5 to 25 Hz and nothing smoother;
 *   flight/position_estimator.h (main branch, after 2025.12) fuses GPS or optical flow with the accelerometer into east, north, up in cm
 *   from where it was armed. Where that is not valid the vehicle is told to be where it should be, at rest: it keeps its height and flies
 *   level, and drifts with the wind as in any angle mode.
 * - Rotor speeds: where DShot telemetry is on; here the model's. */
#include "omnidrones_mixer.h"

#include "hummingbird_cascade.h"

#include "fc/runtime_config.h"
#include "flight/imu.h"
#include "flight/mixer.h"
#include "flight/position_estimator.h"
#include "sensors/gyro.h"

#include <math.h>

#define ROTORS HUMMINGBIRD_CASCADE_INPUT_SIZE
#define RADIANS 0.0174532925f /* in a degree */
#define METRES 0.01f          /* in a centimetre */

/* rotor of the vehicle -> motor of the mixer QUADP, counted from 0, which turns REAR, FRONT clockwise and RIGHT, LEFT counter-clockwise
 * seen from above (yaw_motors_reversed = OFF), as the vehicle does:
 *
 *     rotor_0 front, clockwise     motor 4 FRONT
 *     rotor_1 left, counter        motor 3 LEFT
 *     rotor_2 back, clockwise      motor 1 REAR
 *     rotor_3 right, counter       motor 2 RIGHT */
static const int motorOfRotor[ROTORS] = {3, 2, 0, 1};

static hummingbird_cascade_memory memory;
static float state[HUMMINGBIRD_CASCADE_STATE_SIZE];
static timeUs_t nextTickUs;
static bool flies;

void omnidronesMixerInit(void)
{
    hummingbird_cascade_reset(&memory);
    for (int rotor = 0; rotor < ROTORS; rotor++) state[HUMMINGBIRD_CASCADE_STATE_ROTOR_0_SPEED + rotor] = 0.0f;
    flies = false;
}

static void measure(const omnidronesTarget_t *target)
{
    const positionEstimate3d_t *own = positionEstimatorGetEstimate();
    const float north = own->position.y, west = -own->position.x, up = own->position.z;
    state[0] = own->isValidXY ? METRES * north : target->position[0];
    state[1] = own->isValidXY ? METRES * west : target->position[1];
    state[2] = own->isValidZ ? METRES * up : target->position[2];
    state[3] = own->isValidXY ? METRES * own->velocity.y : target->velocity[0];
    state[4] = own->isValidXY ? -METRES * own->velocity.x : target->velocity[1];
    state[5] = own->isValidZ ? METRES * own->velocity.z : target->velocity[2];
    state[6] = imuAttitudeQuaternion.w;
    state[7] = imuAttitudeQuaternion.x;
    state[8] = imuAttitudeQuaternion.y;
    state[9] = imuAttitudeQuaternion.z;
    for (int axis = 0; axis < 3; axis++) state[10 + axis] = RADIANS * gyro.gyroADCf[axis];
}

/* motor[] is in units of the protocol, from motorOutputLow (idle) to motorOutputHigh: 1000 to 2000 for PWM, OneShot and Multishot, 48 to
 * 2047 for DShot. An ESC's signal is taken for the share of the largest speed, the root of the share of the largest thrust that an action
 * says; Betaflight's own curve (thrust_linear) and its compensation of the battery act in mixTable, not here. */
static void drive(const float input[ROTORS])
{
    const float low = getMotorOutputLow(), high = getMotorOutputHigh();
    for (int rotor = 0; rotor < ROTORS; rotor++) {
        const float share = 0.5f * (input[rotor] + 1.0f);
        motor[motorOfRotor[rotor]] = low + (high - low) * sqrtf(share < 0.0f ? 0.0f : share);
    }
}

void omnidronesMixTable(timeUs_t currentTimeUs, const omnidronesTarget_t *target)
{
    const timeUs_t period = (timeUs_t)(1e6f * HUMMINGBIRD_CASCADE_PERIOD + 0.5f);
    if (!ARMING_FLAG(ARMED)) {
        omnidronesMixerInit();
        for (int rotor = 0; rotor < ROTORS; rotor++) motor[rotor] = motor_disarmed[rotor];
        return;
    }
    if (!flies) {
        flies = true;
        nextTickUs = currentTimeUs;
    }
    /* the loop is faster than the controller: motors keep what they were told */
    if (cmpTimeUs(currentTimeUs, nextTickUs) < 0) return;
    nextTickUs += period;
    measure(target);
    float wanted[HUMMINGBIRD_CASCADE_TARGET_SIZE] = {0.0f};
    for (int axis = 0; axis < 3; axis++) {
        wanted[HUMMINGBIRD_CASCADE_TARGET_POSITION_X + axis] = target->position[axis];
        wanted[HUMMINGBIRD_CASCADE_TARGET_VELOCITY_X + axis] = target->velocity[axis];
    }
    wanted[HUMMINGBIRD_CASCADE_TARGET_YAW] = target->heading;
    float input[ROTORS];
    hummingbird_cascade_tick(&memory, state, wanted, input);
    drive(input);
    hummingbird_cascade_rotors(input, state + HUMMINGBIRD_CASCADE_STATE_ROTOR_0_SPEED);
}
