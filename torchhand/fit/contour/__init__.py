"""Hands fitted to the contours of a picture: registration of many hypotheses at once."""

from torchhand.fit.contour.judged import covariance_of
from torchhand.fit.contour.picture_contours import PictureContours, picture_contours
from torchhand.fit.contour.points import hand_length_px, is_in_picture, is_outer
from torchhand.fit.contour.registration import register
from torchhand.fit.contour.result import Registration, RegistrationStatus
from torchhand.fit.contour.settings import LEVELS, TRACKING_LEVELS, RegistrationLevel, RegistrationSettings

__all__ = [
    "LEVELS",
    "TRACKING_LEVELS",
    "PictureContours",
    "Registration",
    "RegistrationLevel",
    "RegistrationSettings",
    "RegistrationStatus",
    "covariance_of",
    "hand_length_px",
    "is_in_picture",
    "is_outer",
    "picture_contours",
    "register",
]
