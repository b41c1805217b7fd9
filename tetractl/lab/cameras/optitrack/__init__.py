"""OptiTrack cameras, whose frames are received by NatNet, the protocol of the program Motive."""
