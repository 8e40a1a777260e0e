/* Calls functions of the Crazyflie firmware from Python (ctypes). README.md says where they come from. */
#include "fwstub.h"

#include "controller_mellinger.c"

void pid_boot(void);
void controllerPid(control_t *, const setpoint_t *, const sensorData_t *, const state_t *, stabilizerStep_t);
void powerDistributionLegacy(const control_t *, motors_thrust_uncapped_t *);
bool powerDistributionCap(const motors_thrust_uncapped_t *, motors_thrust_pwm_t *);
int sup_update(uint32_t tick, uint32_t age, int motors, const sensorData_t *);
bool supervisorRequestArming(bool);
bool supervisorRequestCrashRecovery(bool);

static controllerMellinger_t mellinger;

/* gains: kR_xy, kR_z, kw_xy, kw_z */
void harness_mellinger_boot(const float *gains) {
  mellinger = g_defaults;
  mellinger.kR_xy = gains[0], mellinger.kR_z = gains[1];
  mellinger.kw_xy = gains[2], mellinger.kw_z = gains[3];
  mellinger.prev_omega_roll = mellinger.prev_omega_pitch = NAN;
}

/* in: quaternion wxyz, gyro FLU deg/s, desired force N, desired yaw deg; out: moments FLU counts, thrust counts */
void harness_mellinger(const float *in, float *out) {
  state_t state = {0};
  setpoint_t setpoint = {0};
  sensorData_t sensors = {0};
  control_t control = {0};
  state.attitudeQuaternion = (quaternion_t){.w = in[0], .x = in[1], .y = in[2], .z = in[3]};
  sensors.gyro = (Axis3f){in[4], in[5], in[6]};
  setpoint.mode.x = setpoint.mode.y = setpoint.mode.z = setpoint.mode.yaw = modeAbs;
  setpoint.acceleration =
      (acc_t){in[7] / mellinger.mass, in[8] / mellinger.mass, in[9] / mellinger.mass - GRAVITY_MAGNITUDE};
  setpoint.attitude.yaw = in[10];
  controllerMellinger(&mellinger, &control, &setpoint, &sensors, &state, 0);
  out[0] = control.roll, out[1] = -control.pitch, out[2] = -control.yaw, out[3] = control.thrust;
}

/* in: roll, pitch, yaw FLU deg, gyro FLU deg/s, velocity, set-point m/s, desired yaw deg, level; out: as above */
void harness_pid(uint32_t step, const float *in, float *out) {
  state_t state = {0};
  setpoint_t setpoint = {0};
  sensorData_t sensors = {0};
  control_t control = {0};
  state.attitude = (attitude_t){in[0], -in[1], in[2]}; /* the firmware's pitch is inverted */
  sensors.gyro = (Axis3f){in[3], in[4], in[5]};
  state.velocity = (velocity_t){in[6], in[7], in[8]};
  setpoint.velocity = (velocity_t){in[9], in[10], in[11]};
  setpoint.mode.x = setpoint.mode.y = setpoint.mode.z = modeVelocity;
  setpoint.mode.yaw = modeAbs;
  setpoint.attitude.yaw = in[12];
  if (in[13] != 0.0f) { /* as supervisorOverrideSetpoint does */
    setpoint.mode.x = setpoint.mode.y = modeDisable;
    setpoint.mode.roll = setpoint.mode.pitch = modeAbs;
    setpoint.mode.yaw = modeVelocity;
    setpoint.attitude = (attitude_t){0};
  }
  controllerPid(&control, &setpoint, &sensors, &state, step);
  out[0] = control.roll, out[1] = -control.pitch, out[2] = -control.yaw, out[3] = control.thrust;
}

/* in: thrust counts, moments FLU counts; out: counts of M1..M4 */
void harness_mixer(float thrust, const int16_t *moments, uint16_t *out) {
  control_t control = {.thrust = thrust, .roll = moments[0], .pitch = -moments[1], .yaw = -moments[2]};
  motors_thrust_uncapped_t uncapped;
  motors_thrust_pwm_t capped;
  powerDistributionLegacy(&control, &uncapped);
  powerDistributionCap(&uncapped, &capped);
  memcpy(out, capped.list, sizeof capped.list);
}

/* accel in g; returns the state's number */
int harness_supervisor(uint32_t tick, uint32_t age, int motors, float ax, float ay, float az) {
  sensorData_t sensors = {.acc = {ax, ay, az}};
  return sup_update(tick, age, motors, &sensors);
}
int harness_arm(int on) { return supervisorRequestArming(on); }
int harness_recover(void) { return supervisorRequestCrashRecovery(true); }
