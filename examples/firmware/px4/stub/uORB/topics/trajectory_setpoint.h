/* Fields that are used, after PX4-Autopilot msg/versioned/TrajectorySetpoint.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct trajectory_setpoint_s {
	std::uint64_t timestamp; /* us */
	float position[3];       /* m north, east, down; NaN: not controlled, as in all of them */
	float velocity[3];       /* m/s */
	float acceleration[3];   /* m/s^2 */
	float yaw;               /* rad, clockwise from north */
	float yawspeed;          /* rad/s about down */
};

ORB_DECLARE(trajectory_setpoint);
