"""What the robot is for: how deep it may cut, where, and how sure.

``cut`` holds the data (tool, coefficients, immersion). ``tool_point`` holds the dynamics at the tool's tip, ``forces``
what the cut adds to them. ``stability`` finds the multipliers of the delay equation, ``zeroth_order`` their closed
form. ``lobes`` finds the limit over spindle speed, ``forced`` the vibration of a stable cut. ``in_time`` steps the same
cut in MuJoCo.
"""
