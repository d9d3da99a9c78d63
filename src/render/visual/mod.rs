//! Path-traced pictures of the scene of a grasp.
