/* Stand-in for PX4's uORB: a topic is its last message, in one process. */
#pragma once

#include <cstddef>
#include <cstdint>

struct orb_metadata {
	void *last;
	std::size_t size;
	unsigned generation;
};

#define ORB_ID(name) (&__orb_##name)
#define ORB_DECLARE(name) extern orb_metadata __orb_##name
#define ORB_DEFINE(name, type) static type last_of_##name{}; orb_metadata __orb_##name{&last_of_##name, sizeof(type), 0}
