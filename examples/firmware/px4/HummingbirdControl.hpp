/* An exported controller as a PX4 module: position to rotors, in place of mc_pos_control, mc_att_control, mc_rate_control and
 * control_allocator.
 *
 * In a PX4 tree (names of topics and fields as in release 1.16) this goes to src/modules/hummingbird_control, beside the exported
 * hummingbird_cascade.c and .h (`float`), with
 *
 *     px4_add_module(MODULE modules__hummingbird_control MAIN hummingbird_control
 *         COMPILE_FLAGS -fno-math-errno
 *         SRCS HummingbirdControl.cpp hummingbird_cascade.c)
 *
 * and a start-up script that does not start those four: whoever publishes actuator_motors must be alone. Left out here, since it says
 * nothing about the exported code: ModuleBase (start, stop, status), parameters, perf counters. */
#pragma once

#include "hummingbird_cascade.h"

#include <drivers/drv_hrt.h>
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/topics/actuator_motors.h>
#include <uORB/topics/trajectory_setpoint.h>
#include <uORB/topics/vehicle_angular_velocity.h>
#include <uORB/topics/vehicle_attitude.h>
#include <uORB/topics/vehicle_control_mode.h>
#include <uORB/topics/vehicle_local_position.h>

class HummingbirdControl : public px4::ScheduledWorkItem
{
public:
	HummingbirdControl();

	/* ticks at the rate that the controller was exported with: its filters, integrators and levels count calls */
	void start();

	void Run() override;

private:
	static constexpr int ROTORS = HUMMINGBIRD_CASCADE_INPUT_SIZE;

	/* rotor of the vehicle -> motor of the airframe, counted from 0.
	 *
	 *     vehicle                      PX4's "Quadrotor +" (SYS_AUTOSTART 5001)
	 *     rotor_0 front, clockwise     motor 3
	 *     rotor_1 left, counter        motor 2
	 *     rotor_2 back, clockwise      motor 4
	 *     rotor_3 right, counter       motor 1
	 *
	 * Places and directions of turn must be the vehicle's (CA_ROTORn_PX, _PY: front, right; _KM: + counter-clockwise); the order is free. */
	static constexpr int MOTOR_OF_ROTOR[ROTORS] = {2, 1, 3, 0};

	void forget();
	bool measure();
	void aim();
	void publish(const float input[ROTORS]);

	uORB::Subscription _control_mode_sub{ORB_ID(vehicle_control_mode)};
	uORB::Subscription _position_sub{ORB_ID(vehicle_local_position)};
	uORB::Subscription _attitude_sub{ORB_ID(vehicle_attitude)};
	uORB::Subscription _rates_sub{ORB_ID(vehicle_angular_velocity)};
	uORB::Subscription _setpoint_sub{ORB_ID(trajectory_setpoint)};
	uORB::Publication<actuator_motors_s> _motors_pub{ORB_ID(actuator_motors)};

	vehicle_control_mode_s _control_mode{};
	vehicle_local_position_s _position{};
	vehicle_attitude_s _attitude{};
	vehicle_angular_velocity_s _rates{};
	trajectory_setpoint_s _setpoint{};

	hummingbird_cascade_memory _memory{};
	float _state[HUMMINGBIRD_CASCADE_STATE_SIZE]{};
	float _target[HUMMINGBIRD_CASCADE_TARGET_SIZE]{};
	float _held[3]{}; /* where to stay without a setpoint of position, m north, east, down */
	float _held_yaw{};
	bool _flies{false};
	bool _is_told{false}; /* whether there was a setpoint since it flies */
};
