//! The kinds of sensors, one line each.

use super::camera::{Camera, CameraDevice, ImageType};
use super::contact::{Contact, ContactDevice};
use super::device::{Channel, Device, KindSettings, ReadingLayout};
use super::gnss::{Gnss, GnssDevice, MotionCapture, MotionCaptureDevice};
use super::inertial::{Imu, ImuDevice};
use super::lidar::{Lidar, LidarDevice};
use super::magnetometer_barometer::{Barometer, BarometerDevice, Magnetometer, MagnetometerDevice};
use super::range_flow::{Flow, FlowDevice, Range, RangeDevice};
use base::error::{Error, Result};
use base::reader;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// One kind of sensor, as a line of [`KINDS`].
#[derive(Clone, Copy)]
pub struct SensorKind {
    /// In settings.
    pub name: &'static str,
    /// What it measures.
    pub about: &'static str,
    /// Keys that stand in a table only where they are given.
    pub(crate) optional: &'static [&'static str],
    read: fn(toml::Table, &str) -> Result<SensorModel>,
    ideal: fn() -> SensorModel,
}

impl SensorKind {
    /// Without errors, at its default place in the world.
    pub fn ideal(&self) -> SensorModel {
        (self.ideal)()
    }

    /// The kind of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the names of all.
    pub fn by_name(name: &str) -> Result<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name).ok_or_else(|| Error::Unknown {
            kind: "kind of sensor",
            name: name.into(),
            known: KINDS.iter().map(|kind| kind.name.to_string()).collect(),
        })
    }

    /// From a table of settings; `place` names it in errors.
    pub(crate) fn read(&self, table: toml::Table, place: &str) -> Result<SensorModel> {
        (self.read)(table, place)
    }
}

impl std::fmt::Debug for SensorKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

fn read<T: DeserializeOwned>(table: toml::Table, place: &str) -> Result<T> {
    reader::of_table(&table).map_err(|fault| fault.in_table(place))
}

fn table<T: Serialize>(settings: &T) -> toml::Table {
    toml::Table::try_from(settings).unwrap_or_default()
}

/// Settings, device and name of every kind from one line each.
macro_rules! kinds {
    ($($name:literal, $kind:ident, $device:ident, $about:literal;)+) => {
        /// What a sensor measures and how wrongly.
        #[derive(Debug, Clone, PartialEq)]
        pub enum SensorModel {
            $(#[doc = $about] $kind($kind),)+
        }

        /// Every kind.
        pub const KINDS: &[SensorKind] = &[
            $(SensorKind {
                name: $name,
                about: $about,
                optional: $kind::OPTIONAL,
                read: |table, place| read(table, place).map(SensorModel::$kind),
                ideal: || SensorModel::$kind($kind::default()),
            },)+
        ];

        impl SensorModel {
            /// Its name in settings.
            pub fn kind(&self) -> &'static str {
                match self { $(Self::$kind(_) => $name,)+ }
            }

            /// Names and units of what it reads, in order.
            pub fn channels(&self) -> Vec<Channel> {
                match self { $(Self::$kind(settings) => settings.channels(),)+ }
            }

            /// How they lie about each other.
            pub fn layout(&self) -> ReadingLayout {
                match self { $(Self::$kind(settings) => settings.layout(),)+ }
            }

            /// Least and largest reading; infinite where there is none.
            pub fn bounds(&self) -> [f64; 2] {
                match self { $(Self::$kind(settings) => settings.bounds(),)+ }
            }

            /// Whether its readings have slopes in the pose: [`SensorGradient::Pose`](super::SensorGradient::Pose).
            pub fn has_slopes(&self) -> bool {
                match self {
                    Self::Lidar(_) | Self::Range(_) => true,
                    Self::Camera(camera) => camera.show == ImageType::Depth,
                    _ => false,
                }
            }

            /// Refuses numbers that no such part has; `what` names the sensor.
            pub(crate) fn validate(&self, what: &str) -> Result<()> {
                match self { $(Self::$kind(settings) => settings.validate(what),)+ }
            }

            pub(crate) fn table(&self) -> toml::Table {
                match self { $(Self::$kind(settings) => table(settings),)+ }
            }

            pub(crate) fn at_work(&self, between: f64) -> Result<SensorInstance> {
                Ok(match self { $(Self::$kind(settings) => SensorInstance::$kind($device::new(settings, between)?),)+ })
            }
        }

        /// A [`SensorModel`] with its state.
        #[derive(Debug, Clone)]
        pub(crate) enum SensorInstance {
            $($kind($device),)+
        }

        impl SensorInstance {
            pub(crate) fn device(&mut self) -> &mut dyn Device {
                match self { $(Self::$kind(device) => device,)+ }
            }
        }
    };
}

kinds! {
    "imu", Imu, ImuDevice, "Specific force and angular velocity along mount axes.";
    "magnetometer", Magnetometer, MagnetometerDevice, "Magnetic field along mount axes.";
    "barometer", Barometer, BarometerDevice, "Static pressure at its height.";
    "gnss", Gnss, GnssDevice, "Position and velocity of an antenna, world axes.";
    "motion_capture", MotionCapture, MotionCaptureDevice, "Pose in the world, at times unseen.";
    "range", Range, RangeDevice, "Distance to the ground, or what stands in the way, along -z of the mount.";
    "flow", Flow, FlowDevice, "Motion of level ground through a picture, along -z of the mount.";
    "contact", Contact, ContactDevice, "Net force of all contacts on its body, along mount axes.";
    "lidar", Lidar, LidarDevice, "Distances along beams.";
    "camera", Camera, CameraDevice, "Depth, what is seen, surfaces or colours, pixel by pixel.";
}
