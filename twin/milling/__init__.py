"""What the robot is for: how deep it may cut, where, and how sure.

``cut`` is the data (tool, coefficients, immersion); ``tool_point`` the dynamics at the tool's tip; ``forces`` what the
cut adds to them; ``stability`` the multipliers of the delay equation, ``zeroth_order`` their closed form; ``lobes`` the
limit over spindle speed; ``forced`` the vibration of a stable cut; ``in_time`` the same cut stepped in MuJoCo.
"""
