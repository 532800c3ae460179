"""What the world is made of: airframe and autopilot, docking tool, wind, sensors, and the compiled loop over them."""
