"""Observations: plain data that are checked once when they are read. Nothing here knows a model."""

from petalfit.observations.camera import Camera as Camera
from petalfit.observations.capture import read_capture as read_capture
from petalfit.observations.contour import Contour as Contour
from petalfit.observations.contour import trace as trace
from petalfit.observations.errors import TargetError as TargetError
from petalfit.observations.files import is_mask_file as is_mask_file
from petalfit.observations.files import looks_like_a_mask as looks_like_a_mask
from petalfit.observations.files import read_target as read_target
from petalfit.observations.files import read_targets as read_targets
from petalfit.observations.frames import cameras_of as cameras_of
from petalfit.observations.images import IMAGE_SUFFIXES as IMAGE_SUFFIXES
from petalfit.observations.observation import AbstractObservation as AbstractObservation
from petalfit.observations.observation import observation_from_json as observation_from_json
from petalfit.observations.point_cloud import PointCloud as PointCloud
from petalfit.observations.point_cloud import as_point_cloud as as_point_cloud
from petalfit.observations.readers import SUFFIXES as SUFFIXES
from petalfit.observations.silhouette import Silhouette as Silhouette
from petalfit.observations.texture import Texture as Texture
from petalfit.observations.transforms import read_cameras as read_cameras
from petalfit.observations.transforms import read_frames as read_frames
from petalfit.observations.transforms import read_transforms as read_transforms
