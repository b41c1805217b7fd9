"""Measured properties of real cells, which the simulation samples and the controller assumes.

packages/tetractl-microscope/docs/cells-explained.md gives the source of each number. `guess` means
that no source was found.
"""

BODY_UM = 52.3, 7.8  # length, mean and standard deviation over n = 1504
WIDTH_UM = 26.3, 4.5  # width, the same
SPEED_UM_S = 420.0  # median of swimmers at 20 C
SPEED_LOG_SD = 0.25  # standard deviation of log(speed): speeds are log-normal
ACTIVATION_EV = 0.27  # activation energy: middle of 0.16 to 0.37 eV
BOLTZMANN_EV_K = 8.617e-5  # Boltzmann's constant [eV/K]
ZERO_C_K = 273.15  # 0 C [K]
WARM_C = 20.0  # the temperature of SPEED_UM_S
HELIX_HZ = 2.5, 0.3  # frequency of the helix, mean and standard deviation
HELIX_UM = 8.0, 1.5  # guess: its radius, the same
A_RAD_S = 4.0  # guess: median turning rate at the reference field
A_LOG_SD = 0.25  # guess: standard deviation of log(turning rate)
DIPOLE_SD_RAD = 0.1  # guess: standard deviation of the angle between dipole and body axis
WALK_RAD_S = 0.05  # guess: rad/sqrt(s)
DRIFT_UM_S = 3.0  # guess: slow flow of the medium
RESTS_S = 6.0, 1.0  # guess: means until a cell rests, or backs off and turns, and of its duration
REST_STRAY = 0.2  # guess: random walk of its position meanwhile, over its speed [sqrt(s)]
REST_TURN = 1.0  # guess: random walk of its heading meanwhile [rad/sqrt(s)]
DIVIDED_LENGTH = 0.8  # guess: length of a cell that has divided, over the mother's
DIVIDED_MAGNET = 0.3, 0.7  # guess: bounds of the share of the magnet that one of them gets
DIVIDED_TURN_RAD = 0.4, 0.8  # guess: bounds of the angle by which each turns aside
