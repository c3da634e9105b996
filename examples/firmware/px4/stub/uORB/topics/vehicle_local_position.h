/* Fields that are used, after PX4-Autopilot msg/versioned/VehicleLocalPosition.msg (names, types and units). */
#pragma once

#include <uORB/uORB.h>

struct vehicle_local_position_s {
	std::uint64_t timestamp;        /* us */
	std::uint64_t timestamp_sample; /* us */
	bool xy_valid;
	bool z_valid;
	bool v_xy_valid;
	bool v_z_valid;
	float x;                        /* m north */
	float y;                        /* m east */
	float z;                        /* m down */
	float vx;                       /* m/s north */
	float vy;                       /* m/s east */
	float vz;                       /* m/s down */
	float heading;                  /* rad, clockwise from north */
};

ORB_DECLARE(vehicle_local_position);
