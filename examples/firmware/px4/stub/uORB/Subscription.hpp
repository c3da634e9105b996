#pragma once

#include <uORB/uORB.h>

#include <cstring>

namespace uORB
{
class Subscription
{
public:
	explicit Subscription(const orb_metadata *topic) : _topic(topic) {}

	/* whether there was a new message */
	bool update(void *message)
	{
		if (_seen == _topic->generation) { return false; }

		_seen = _topic->generation;
		std::memcpy(message, _topic->last, _topic->size);
		return true;
	}

private:
	const orb_metadata *_topic;
	unsigned _seen{0};
};
}
