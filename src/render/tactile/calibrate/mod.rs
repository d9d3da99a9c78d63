//! Fits a sensor's profile to real presses of a ball.
