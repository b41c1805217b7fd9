/* What the m3pi's programs for all boards share: which robot it is, and the rates of its serial ports.
 *
 * Only the board's main file includes it.
 */
#ifndef M3PI_ROBOT_H
#define M3PI_ROBOT_H

#include "m3pi_shell.h"

#ifndef ROBOT_INDEX
#error "define ROBOT_INDEX: the robot's place in the spec, from 0"
#endif
#ifndef RADIO_BAUD
#define RADIO_BAUD 57600u
#endif
#define BASE_BAUD 115200u /* of Pololu's serial slave program */

static const uint32_t port_baud[M3PI_PORTS] = {RADIO_BAUD, BASE_BAUD};

#endif
