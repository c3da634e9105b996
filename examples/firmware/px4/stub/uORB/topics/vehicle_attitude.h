/* Fields that are used, after PX4-Autopilot msg/versioned/VehicleAttitude.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct vehicle_attitude_s {
	std::uint64_t timestamp;        /* us */
	std::uint64_t timestamp_sample; /* us */
	float q[4];                     /* w, x, y, z: Hamilton, from forward, right, down to north, east, down */
};

ORB_DECLARE(vehicle_attitude);
