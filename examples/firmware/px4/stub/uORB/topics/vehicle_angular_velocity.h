/* Fields that are used, after PX4-Autopilot msg/versioned/VehicleAngularVelocity.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct vehicle_angular_velocity_s {
	std::uint64_t timestamp;        /* us */
	std::uint64_t timestamp_sample; /* us */
	float xyz[3];                   /* rad/s about forward, right, down */
};

ORB_DECLARE(vehicle_angular_velocity);
