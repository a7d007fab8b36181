"""Trials with concealed physics: cases from the truth code, the `twin` command asked blindly, answers scored after."""
