//! Flights as pages for a browser: one file that asks nothing of any network, or live on loopback.
//!
//! A [`Recording`] is a table of whole numbers with what they mean: who flies and what they look like ([`Look`]), poses of
//! bodies, speeds of rotors, targets, forces, errors. [`page`] puts one or several into one HTML file, [`Server`] shows one that
//! grows.
//!
//! | file | idea |
//! |---|---|
//! | `look.rs` | what a plant looks like: bodies with shapes, rotors, struts; their poses in a state |
//! | `recording.rs` | the table: actors, their columns, rows |
//! | `pack.rs` | columns as bytes, bytes as text |
//! | `flights.rs` | recordings of closed-loop flights and falls |
//! | `episodes.rs` | recordings of the episodes of a task |
//! | `page.rs` | the HTML file |
//! | `live.rs` | a page that is served while something flies |
//! | `foxglove.rs` | schemas that other viewers know, as protobuf; feature `mcap` |
//! | `mcap.rs` | logs for Foxglove and rerun; feature `mcap` |
//! | `web/` | the page's script, its styles, and how they are made |
//!
//! ```
//! use omnidrones::controllers::{FlightPlan, fly_vehicle};
//! use omnidrones::dynamics::{Physics, Plant, vehicles};
//! use omnidrones_viewer::{flight, page};
//!
//! let vehicle = vehicles::by_name("hummingbird")?;
//! let plan = FlightPlan { duration: 0.5, ..FlightPlan::default() };
//! let flown = fly_vehicle(&vehicle, &vehicle.gains(), &plan, &mut |_| {})?;
//! let plant = Plant::of_vehicle(&vehicle, Physics::default())?;
//! let html = page("A flight", &[flight(&plant, &flown, &plan)]);
//! assert!(html.contains("hummingbird") && html.len() < 900_000);
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

mod episodes;
mod flights;
#[cfg(feature = "mcap")]
mod foxglove;
mod live;
mod look;
#[cfg(feature = "mcap")]
mod mcap;
mod pack;
mod page;
mod recording;

pub use episodes::{Episodes, goal};
pub use flights::{fall, flight};
pub use live::Server;
pub use look::Look;
#[cfg(feature = "mcap")]
pub use mcap::{Track, write_mcap};
pub use page::page;
pub use recording::{Actor, Ended, Event, Measure, Moment, Mount, Recording, View};
