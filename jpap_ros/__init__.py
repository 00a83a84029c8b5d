"""Live UAV fleet deployment: plan, allocate power, and fly there over MAVLink."""
