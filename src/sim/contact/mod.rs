//! Contact mathematics: distances, barrier, edge-edge mollifier, friction, continuous collision.
