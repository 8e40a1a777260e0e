"""What the controller remembers, and its configuration, as records for compiled code."""

from __future__ import annotations

from typing import Annotated

from flightstack.compiled.program import ProgramRecord
from flightstack.compiled.records import F64, Record, Vector
from sim.autopilot.watches import WatchRecord

Five = Annotated[F64, 5]
Six = Annotated[F64, 6]
Nine = Annotated[F64, 9]
Thirteen = Annotated[F64, 13]


class MindRecord(Record):
    """Of the controller's memory what may change in a stretch; times on its clock."""

    # mission
    contact_since_s: float
    stopped_since_s: float
    commanding: bool
    command: Vector
    target_position: Vector  # of now, as estimated
    target_velocity: Vector
    # track: the newest sample
    sample_arrival_s: float
    sample_source_s: float
    sample_position: Vector
    sample_velocity: Vector
    sample_yaw: float
    sample_rate: float
    offset_s: float
    accepted: int  # in this stretch
    # estimate of the target
    time_s: float
    position: Vector
    velocity: Vector
    acceleration: Vector
    yaw: float  # NaN: not known
    turn_rate: float
    surprise: float
    covariance_xy: Six
    covariance_z: Six
    # corrections of the set-point
    slope: Vector
    setpoint: Vector
    model: Vector
    model_2: Vector
    disturbance: Vector
    # plausibility: the newest own state
    own_arrival_s: float
    own_source_s: float
    own_position: Vector
    own_velocity: Vector
    own_yaw: float
    drift: Vector
    missed: Vector
    # what is learned of the own state
    own_time_s: float
    own_x: Five
    own_y: Five
    own_z_m: float
    own_z_error_m_s: float
    own_x_now: Five
    own_y_now: Five
    told: Vector  # set-point as it is sent
    pending: Annotated[F64, 12]
    # thrust reserve
    effort: float
    rise_m_s: float
    # track: positions of the target against its velocity
    target_drift: Vector
    target_drift_smooth: Vector
    # of this tick
    step: Vector  # by which the velocity wanted may change
    up_step_m_s: float  # besides, upwards
    rises_m_s2: float  # upward acceleration that is left
    target_age_s: float
    floor_s: float  # of the target's clock
    held_s: float


class RulesRecord(Record):
    """What does not change in a stretch: configuration, phase, and what the vehicle says."""

    # of the phase
    phase: int
    flies: bool  # set-points go out
    since_s: float
    started_s: float
    status_s: float  # arrival of the heartbeat
    ends_s: float  # when the flight is too long
    # configuration
    paper: bool  # the paper's filter, else the robust one
    period_s: float
    own_age_max_s: float
    learns: bool  # of the own state
    own_model: Five
    own_gains: Annotated[F64, 10]
    own_ahead: int
    own_gap_max: int
    own_push_1_s: float
    own_rate_up_1_s: float
    own_most_m_s: float
    own_delay_s: float
    own_noise_m: float
    drift_memory_s: float
    drift2_max_m2: float  # nearer to the bounds than this Python decides
    missed2_max_m2: float
    missed_kept: float
    target_age_max_s: float
    ahead_max_s: float
    target_speed2_max: float
    target_jump2_max: float
    target_drift_memory_s: float
    target_drift2_max_m2: float
    target_delay_s: float
    fade_s: float
    turns: bool
    growth2_max: float
    noise_xy: Annotated[F64, 4]  # squares: position, velocity, jerk, acceleration
    noise_z: Annotated[F64, 4]
    status_age_max_s: float
    landing_time_max_s: float
    over_pad_time_max_s: float
    settle_s: float
    alpha_1_m: float
    beta_m: float
    smoothing_m: float
    pad_radius_m: float
    low_m: float  # height below which it may be over the pad
    slope_at_pad: float
    sigma_factor: float
    margin_fixed_m: float
    margin_full: float  # share of the margin at the pad's edge
    margin_fade_m: float
    rate_1_s: float
    lag_z_s: float
    gain_1_s: float
    gain_over_1_s: float
    gain_contact_1_s: Vector  # on the way down to contact; of the paper's filter all the way
    touch_height_m: float
    wait_height_m: float
    descent_max_m_s: float
    descent_min_m_s: float
    descent_m_s: float
    brakes_m_s2: float
    standing_m: float
    commit_height_m: float
    commit_speed_m_s: float
    commit_radius_m: float
    corridor_m: float
    drift_time_s: float
    h_left_m: float
    touchdown_time_s: float
    contact_speed_m_s: float
    beyond_m: float
    feet_m: float
    gap_m: float
    sinks_m_s: float
    contact_time_s: float
    stopped_time_s: float
    stopped_below_m: float
    sliding_gap_m: float
    sliding_radius_m: float
    most: Vector
    altitude_max_m: float
    yaw_rad: float
    by_feedback: bool
    lead_xy: Nine
    lead_z: Nine
    feedback: Thirteen
    far_feedback: Thirteen  # farther from the landing spot than
    far_m: float
    calm_wait_s: float
    calm_speed_m_s: float
    calm_height_m: float
    calm_gain_1_s: float
    # the thrust reserve, and what the vehicle told of its power last
    weighs: bool
    reserve_share: float
    reserve_lasting_m_s: float
    reserve_least: float
    thrust_share: float
    reserve_most_m_s2: Vector
    power_s: float
    effort_flying: float
    effort_resting: float
    reserve_sags: float
    reserve_most: float
    # the vehicle's autopilot
    yaw_told_rad: float  # heading as it arrives there
    cos_yaw: float
    sin_yaw: float
    speeds: Vector  # m/s, over ground, up, down
    delay_ms: int  # of the radio
    armed: bool
    standing: bool
    supervisor: int  # state of the firmware's supervisor
    stream_until_s: float  # the autopilot waits for set-points until then; without them
    watch: WatchRecord
    program: ProgramRecord
