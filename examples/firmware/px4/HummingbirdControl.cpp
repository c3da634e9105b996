#include "HummingbirdControl.hpp"

#include <cmath>

constexpr int HummingbirdControl::MOTOR_OF_ROTOR[];

HummingbirdControl::HummingbirdControl() : ScheduledWorkItem("hummingbird_control", px4::wq_configurations::rate_ctrl)
{
	forget();
}

void HummingbirdControl::start()
{
	ScheduleOnInterval(static_cast<uint32_t>(1e6f * HUMMINGBIRD_CASCADE_PERIOD + 0.5f));
}

void HummingbirdControl::Run()
{
	_control_mode_sub.update(&_control_mode);

	if (!_control_mode.flag_armed || !measure()) {
		forget();
		return;
	}

	if (!_flies) {
		_flies = true;
		_held[0] = _position.x;
		_held[1] = _position.y;
		_held[2] = _position.z;
		_held_yaw = _position.heading;
	}

	aim();
	float input[ROTORS];
	hummingbird_cascade_tick(&_memory, _state, _target, input);
	publish(input);
	/* nobody measures the rotors' speeds here: the model says what they will be in the next tick. With telemetry (esc_status) write
	 * those, in rad/s, into the state before the tick instead */
	hummingbird_cascade_rotors(input, _state + HUMMINGBIRD_CASCADE_STATE_ROTOR_0_SPEED);
}

/* disarmed, or blind: motors stand still, and the next flight begins anew */
void HummingbirdControl::forget()
{
	hummingbird_cascade_reset(&_memory);
	_flies = false;
	_is_told = false;

	for (int rotor = 0; rotor < ROTORS; rotor++) {
		_state[HUMMINGBIRD_CASCADE_STATE_ROTOR_0_SPEED + rotor] = 0.f;
	}

	actuator_motors_s motors{};
	motors.timestamp = hrt_absolute_time();

	for (float &control : motors.control) { control = NAN; }

	_motors_pub.publish(motors);
}

/* false where the position is unknown. Estimates that are old are not told here: what a vehicle does then is a failsafe's to say */
bool HummingbirdControl::measure()
{
	_position_sub.update(&_position);
	_attitude_sub.update(&_attitude);
	_rates_sub.update(&_rates);

	const bool is_known = _position.xy_valid && _position.z_valid && _position.v_xy_valid && _position.v_z_valid;

	if (!is_known || _attitude.timestamp == 0 || _rates.timestamp == 0) {
		return false;
	}

	const float position[3] = {_position.x, _position.y, _position.z};
	const float velocity[3] = {_position.vx, _position.vy, _position.vz};
	hummingbird_cascade_state_from_ned(position, velocity, _attitude.q, _rates.xyz, _state);
	return true;
}

/* a setpoint's NaN means "do not control this": this controller always has all of them, so what is left open is where it was, or zero */
void HummingbirdControl::aim()
{
	_is_told = _setpoint_sub.update(&_setpoint) || _is_told;
	float position[3], velocity[3]{}, acceleration[3]{};
	float yaw = _held_yaw, yaw_rate = 0.f;

	for (int k = 0; k < 3; k++) {
		position[k] = _held[k];

		if (_is_told) {
			if (std::isfinite(_setpoint.position[k])) { position[k] = _setpoint.position[k]; }

			if (std::isfinite(_setpoint.velocity[k])) { velocity[k] = _setpoint.velocity[k]; }

			if (std::isfinite(_setpoint.acceleration[k])) { acceleration[k] = _setpoint.acceleration[k]; }
		}
	}

	if (_is_told && std::isfinite(_setpoint.yaw)) { yaw = _setpoint.yaw; }

	if (_is_told && std::isfinite(_setpoint.yawspeed)) { yaw_rate = _setpoint.yawspeed; }

	hummingbird_cascade_target_from_ned(position, velocity, acceleration, yaw, yaw_rate, _target);
}

/* actuator_motors holds shares of the largest thrust, which is what an action in [-1, 1] says: (action + 1)/2.
 *
 * PX4 turns a share into a signal x by share = f x^2 + (1 - f) x, f = THR_MDL_FAC. Our rotors' thrust is the square of their speed; for
 * an ESC whose signal is the share of the speed, THR_MDL_FAC = 1 makes rotors thrust as asked. With 0, PX4's default, the signal is the
 * share itself and the thrust its square: the vehicle of this example, which hovers at a share of 0.29, would get 0.09 and not lift.
 * Measure it on a thrust stand; 0.3 to 1 is usual. MPC_THR_HOVER plays no part. */
void HummingbirdControl::publish(const float input[ROTORS])
{
	actuator_motors_s motors{};
	motors.timestamp = hrt_absolute_time();
	motors.timestamp_sample = _rates.timestamp_sample;

	for (float &control : motors.control) { control = NAN; }

	for (int rotor = 0; rotor < ROTORS; rotor++) {
		motors.control[MOTOR_OF_ROTOR[rotor]] = 0.5f * (input[rotor] + 1.f);
	}

	_motors_pub.publish(motors);
}
