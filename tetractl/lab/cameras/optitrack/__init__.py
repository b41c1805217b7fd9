"""OptiTrack cameras, received by NatNet, the protocol of Motive."""
