"""What the robot does: linear model, modes, FRFs, hammer tests, replay in time, and torque beside a motion log."""

import mujoco

# MuJoCo writes its warnings to a file in the user's folder; what matters of them is checked where models are stepped
mujoco.set_mju_user_warning(lambda text: None)
