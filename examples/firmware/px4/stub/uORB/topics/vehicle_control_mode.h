/* Fields that are used, after PX4-Autopilot msg/versioned/VehicleControlMode.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct vehicle_control_mode_s {
	std::uint64_t timestamp; /* us */
	bool flag_armed;
};

ORB_DECLARE(vehicle_control_mode);
