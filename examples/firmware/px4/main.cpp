/* The module against the exported vehicle: armed on the ground, it climbs to 1.5 m and flies to 1 m north, 2 m east, nose east.
 *
 *     cc -std=c99 -O2 -c hummingbird.c hummingbird_cascade.c
 *     c++ -std=c++14 -O2 -I. -Istub main.cpp HummingbirdControl.cpp hummingbird.o hummingbird_cascade.o -o px4_hover && ./px4_hover */
#include "HummingbirdControl.hpp"

#include "hummingbird.h"

#include <cmath>
#include <cstdio>

ORB_DEFINE(vehicle_control_mode, vehicle_control_mode_s);
ORB_DEFINE(vehicle_local_position, vehicle_local_position_s);
ORB_DEFINE(vehicle_attitude, vehicle_attitude_s);
ORB_DEFINE(vehicle_angular_velocity, vehicle_angular_velocity_s);
ORB_DEFINE(trajectory_setpoint, trajectory_setpoint_s);
ORB_DEFINE(actuator_motors, actuator_motors_s);

static hrt_abstime now = 0;

hrt_abstime hrt_absolute_time()
{
	return now;
}

/* what PX4's estimator would say of a state of the vehicle: x north, y west, z up there; north, east, down here */
static void estimate(const float *state)
{
	vehicle_local_position_s position{};
	position.timestamp = position.timestamp_sample = now;
	position.xy_valid = position.z_valid = position.v_xy_valid = position.v_z_valid = true;
	position.x = state[HUMMINGBIRD_STATE_POSITION_X];
	position.y = -state[HUMMINGBIRD_STATE_POSITION_Y];
	position.z = -state[HUMMINGBIRD_STATE_POSITION_Z];
	position.vx = state[HUMMINGBIRD_STATE_VELOCITY_X];
	position.vy = -state[HUMMINGBIRD_STATE_VELOCITY_Y];
	position.vz = -state[HUMMINGBIRD_STATE_VELOCITY_Z];
	const float *q = state + HUMMINGBIRD_STATE_ATTITUDE_W;
	position.heading = -std::atan2(2.f * (q[0] * q[3] + q[1] * q[2]), 1.f - 2.f * (q[2] * q[2] + q[3] * q[3]));
	uORB::Publication<vehicle_local_position_s>(ORB_ID(vehicle_local_position)).publish(position);
	const vehicle_attitude_s attitude{now, now, {q[0], q[1], -q[2], -q[3]}};
	uORB::Publication<vehicle_attitude_s>(ORB_ID(vehicle_attitude)).publish(attitude);
	const float *w = state + HUMMINGBIRD_STATE_ANGULAR_VELOCITY_X;
	const vehicle_angular_velocity_s rates{now, now, {w[0], -w[1], -w[2]}};
	uORB::Publication<vehicle_angular_velocity_s>(ORB_ID(vehicle_angular_velocity)).publish(rates);
}

int main()
{
	float state[HUMMINGBIRD_STATE_SIZE]{}, input[HUMMINGBIRD_INPUT_SIZE];
	state[HUMMINGBIRD_STATE_ATTITUDE_W] = 1.f;
	static const int motor_of_rotor[HUMMINGBIRD_INPUT_SIZE] = {2, 1, 3, 0};
	HummingbirdControl control;
	control.start();
	uORB::Subscription motors_sub{ORB_ID(actuator_motors)};
	actuator_motors_s motors{};
	vehicle_control_mode_s mode{};

	const int ticks = 6000, armed = 100, moved = 3000;

	for (int tick = 0; tick < ticks; tick++, now += control.interval()) {
		estimate(state);

		if (tick == armed) {
			mode.flag_armed = true;
			uORB::Publication<vehicle_control_mode_s>(ORB_ID(vehicle_control_mode)).publish(mode);
		}

		if (tick == armed || tick == moved) {
			const float north = tick == moved ? 1.f : NAN, east = tick == moved ? 2.f : NAN, yaw = tick == moved ? 1.5708f : NAN;
			const trajectory_setpoint_s setpoint{now, {north, east, -1.5f}, {NAN, NAN, NAN}, {NAN, NAN, NAN}, yaw, NAN};
			uORB::Publication<trajectory_setpoint_s>(ORB_ID(trajectory_setpoint)).publish(setpoint);
		}

		control.Run();

		if (!motors_sub.update(&motors)) { return std::printf("no motors in tick %d\n", tick), 1; }

		for (int rotor = 0; rotor < HUMMINGBIRD_INPUT_SIZE; rotor++) {
			const float share = motors.control[motor_of_rotor[rotor]];

			if (std::isfinite(share) != (tick >= armed)) { return std::printf("motors in tick %d\n", tick), 1; }

			input[rotor] = std::isfinite(share) ? 2.f * share - 1.f : -1.f;
		}

		hummingbird_step(state, input, state);

		/* the ground */
		if (state[2] < 0.f) {
			state[2] = 0.f;
			state[5] = 0.f;
		}

		if (tick + 1 == moved || tick + 1 == ticks) {
			std::printf("after %d ticks: %.3f m north, %.3f m east, %.3f m up, yaw %.3f rad\n", tick + 1, static_cast<double>(state[0]),
				    static_cast<double>(-state[1]), static_cast<double>(state[2]), static_cast<double>(-2.f * std::atan2(state[9], state[6])));
			const float north = tick + 1 == moved ? 0.f : 1.f, east = tick + 1 == moved ? 0.f : 2.f;
			const float off = std::fabs(state[0] - north) + std::fabs(-state[1] - east) + std::fabs(state[2] - 1.5f);

			if (!(off < 0.05f)) { return std::printf("%.3f m away from where it should be\n", static_cast<double>(off)), 1; }
		}
	}

	return 0;
}
