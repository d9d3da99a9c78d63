//! The grasp of the paper: closure, force adjustment, lift.
