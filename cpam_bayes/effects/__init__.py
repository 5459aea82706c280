"""What a bare plate may lack: functions from a problem to a problem, one file a family."""

from cpam_bayes.effects.known_mass import add_known_mass

__all__ = ["add_known_mass"]
