"""A vehicle with any release and any parameters on a socket; independent of the tables of the rules."""

import threading

from bridge.mavlink.endpoint import Endpoint, dialect

COMMON = {
    "GUID_TIMEOUT": 0.5, "GUID_OPTIONS": 0, "DISARM_DELAY": 10, "FS_EKF_ACTION": 1, "FS_GCS_ENABLE": 5,
    "FS_THR_ENABLE": 0, "BATT_FS_LOW_ACT": 0, "BATT_FS_CRT_ACT": 1, "FENCE_ENABLE": 0,
}  # fmt: skip
ARDUPILOT_46 = COMMON | {
    "WPNAV_SPEED": 1000, "WPNAV_SPEED_UP": 250, "WPNAV_SPEED_DN": 150, "WPNAV_ACCEL": 250,
    "WPNAV_ACCEL_Z": 250, "ARMING_CHECK": 1, "SYSID_MYGCS": 1, "SYSID_ENFORCE": 1, "SERIAL0_OPTIONS": 0,
    "SERIAL1_OPTIONS": 1024, "SERIAL2_OPTIONS": 0,
}  # fmt: skip
ARDUPILOT_47 = COMMON | {
    "WP_SPD": 10, "WP_SPD_UP": 2.5, "WP_SPD_DN": 1.5, "WP_ACC": 2.5, "WP_ACC_Z": 2.5, "ARMING_SKIPCHK": 0,
    "MAV_GCS_SYSID": 1, "MAV_GCS_SYSID_HI": 0, "MAV_OPTIONS": 1, "MAV1_OPTIONS": 0, "MAV2_OPTIONS": 2,
    "ATC_INPUT_TC": 0.05,
}  # fmt: skip
PX4_116 = {
    "COM_OF_LOSS_T": 1.0, "MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5,
    "COM_DISARM_PRFLT": 10.0, "GF_MAX_VER_DIST": 0.0, "GF_MAX_HOR_DIST": 0.0, "GF_ACTION": 2,
    "NAV_DLL_ACT": 0, "COM_LOW_BAT_ACT": 2, "SYS_FAILURE_EN": 0, "COM_OBL_RC_ACT": 4, "COM_RC_IN_MODE": 4,
    "COM_RCL_EXCEPT": 4, "COM_RC_OVERRIDE": 3, "MAV_FWDEXTSP": 1, "NAV_RCL_ACT": 2, "COM_ACT_FAIL_ACT": 0,
    "COM_WIND_MAX_ACT": 0, "COM_POS_LOW_ACT": 3, "COM_ARM_ODID": 0,
}  # fmt: skip
PX4_118 = {n: v for n, v in PX4_116.items() if n != "COM_RC_OVERRIDE"} | {
    "MAN_OVERRIDE_SPD": 1.0, "FD_ALT_LOSS": 0.0, "EKF2_SENS_EN": 8191, "COM_LOW_BAT_ACT": 5,
    "NAV_RCL_ACT": 7, "COM_GNSSLOSS_ACT": 0,
}  # fmt: skip
SAFE = {
    **{("ardupilot", release): ARDUPILOT_46 for release in ("4.5", "4.6")},
    **{("ardupilot", release): ARDUPILOT_47 for release in ("4.7", "4.8")},
    **{("px4", release): PX4_116 for release in ("1.15", "1.16", "1.17")},
    ("px4", "1.18"): PX4_118,
}
OFFICIAL, DEV = 255, 0


def packed(release, kind=OFFICIAL):
    """``flight_sw_version`` of a release such as 4.7."""
    major, minor = map(int, release.split("."))
    return major << 24 | minor << 16 | kind


class FakeRelease:
    """Answers requests for its version (None: never) and its parameters until it is closed."""

    def __init__(self, autopilot, version, parameters, *, says_unknown=True):
        self.endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1)
        self._px4 = autopilot == "px4"
        self._version, self._parameters, self._says_unknown = version, parameters, says_unknown
        self.asked = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def url(self):
        return f"udpout:127.0.0.1:{self.endpoint.local_port}"

    def _run(self):
        heartbeat = dialect.MAVLink_heartbeat_message(2, 12 if self._px4 else 3, 1, 0, 3, 3)
        while not self._over.is_set():
            self.endpoint.send([heartbeat])
            self.endpoint.wait(0.01)
            for received in self.endpoint.receive():
                self.asked.append(received.message)
                self.endpoint.send(self._replies(received.message), received.peer)

    def _replies(self, message):
        if message.get_type() == "COMMAND_LONG" and message.command == 512 and self._version is not None:
            zeros = [0] * 8
            return [dialect.MAVLink_autopilot_version_message(
                0, self._version, 0, 0, 0, zeros, zeros, zeros, 0, 0, 0)]  # fmt: skip
        if message.get_type() != "PARAM_REQUEST_READ":
            return []
        name = message.param_id
        if name in self._parameters:
            return [self._value(name, self._parameters[name])]
        error = dialect.MAVLink_param_error_message(1, 191, name.encode(), -1, 1)
        return [error] if self._says_unknown else []

    def _value(self, name, value):
        kind, number = 9, float(value)
        if self._px4 and isinstance(value, int):  # its bytes travel
            kind, number = 6, dialect.struct.unpack("<f", dialect.struct.pack("<i", value))[0]
        return dialect.MAVLink_param_value_message(name.encode(), number, kind, len(self._parameters), 0)

    def close(self):
        self._over.set()
        self._thread.join(10.0)
        self.endpoint.close()
