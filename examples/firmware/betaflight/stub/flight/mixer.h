/* What is used, after Betaflight src/main/flight/mixer.h. */
#pragma once

#define MAX_SUPPORTED_MOTORS 8

extern float motor[MAX_SUPPORTED_MOTORS];
extern float motor_disarmed[MAX_SUPPORTED_MOTORS];

float getMotorOutputLow(void);
float getMotorOutputHigh(void);
