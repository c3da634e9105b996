/* Fields that are used, after PX4-Autopilot msg/versioned/ActuatorMotors.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct actuator_motors_s {
	static constexpr std::uint8_t NUM_CONTROLS = 12;
	std::uint64_t timestamp;        /* us */
	std::uint64_t timestamp_sample; /* us */
	std::uint16_t reversible_flags;
	float control[12];              /* -1 to 1, shares of the largest thrust; NaN stops the motor */
};

ORB_DECLARE(actuator_motors);
