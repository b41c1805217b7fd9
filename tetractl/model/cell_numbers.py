"""Measured properties of real cells, which the simulation samples and the controller assumes.

packages/tetractl-microscope/docs/cells-explained.md gives the source of each number. "Guess" means
that no source was found.
"""

BODY_LENGTH_UM = 52.3, 7.8
"""Length of a cell's body [um]: mean and standard deviation, n = 1504."""
BODY_WIDTH_UM = 26.3, 4.5
"""Width of a cell's body [um]: mean and standard deviation, n = 1504."""
SPEED_UM_S = 420.0
"""Median speed of swimming cells at REFERENCE_C [um/s]."""
SPEED_LOG_SD = 0.25
"""Standard deviation of log(speed). Speeds are log-normal."""
ACTIVATION_EV = 0.27
"""Activation energy of swimming [eV]: the middle of 0.16 to 0.37 eV."""
BOLTZMANN_EV_K = 8.617e-5
"""Boltzmann's constant [eV/K]."""
ZERO_C_K = 273.15
"""The temperature 0 C [K]."""
REFERENCE_C = 20.0
"""Temperature at which cells have the speed SPEED_UM_S [C]."""
HELIX_HZ = 2.5, 0.3
"""Frequency of a cell's helix [Hz]: mean and standard deviation."""
HELIX_UM = 8.0, 1.5
"""Radius of a cell's helix [um]: mean and standard deviation (guess)."""
A_RAD_S = 4.0
"""Median turning rate at the reference field [rad/s] (guess)."""
A_LOG_SD = 0.25
"""Standard deviation of log(turning rate) (guess)."""
DIPOLE_SD_RAD = 0.1
"""Standard deviation of the angle between the dipole and the axis of the body [rad] (guess)."""
WALK_RAD_S = 0.05
"""Random walk of a cell's heading [rad/sqrt(s)] (guess)."""
DRIFT_UM_S = 3.0
"""Speed of a slow flow of the medium [um/s] (guess)."""
RESTS_S = 6.0, 1.0
"""Mean time until a cell rests, or backs off and turns, and mean duration of this [s] (guess)."""
REST_STRAY = 0.2
"""Random walk of a resting cell's position, divided by the cell's speed [sqrt(s)] (guess)."""
REST_TURN = 1.0
"""Random walk of a resting cell's heading [rad/sqrt(s)] (guess)."""
DIVIDED_LENGTH = 0.8
"""Length of a cell that has divided, as a fraction of the mother's length (guess)."""
DIVIDED_MAGNET = 0.3, 0.7
"""Bounds of the fraction of the magnet that one of the two cells gets (guess)."""
DIVIDED_TURN_RAD = 0.4, 0.8
"""Bounds of the angle by which each of the two cells turns aside [rad] (guess)."""
