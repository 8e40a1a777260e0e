"""Safe parameters of every autopilot release, written independently of the rules' tables."""

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
    """Return ``flight_sw_version`` of a release such as 4.7."""
    major, minor = map(int, release.split("."))
    return major << 24 | minor << 16 | kind
