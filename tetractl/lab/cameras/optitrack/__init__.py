"""NatNet, the protocol of OptiTrack's Motive: datagrams to messages and back, without sockets."""
