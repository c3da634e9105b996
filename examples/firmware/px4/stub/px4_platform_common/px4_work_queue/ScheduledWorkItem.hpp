/* Stand-in for PX4's work queue: who schedules asks how often, and calls Run. */
#pragma once

#include <cstdint>

namespace px4
{
struct wq_config_t {
	const char *name;
};

namespace wq_configurations
{
static constexpr wq_config_t rate_ctrl{"wq:rate_ctrl"};
}

class ScheduledWorkItem
{
public:
	ScheduledWorkItem(const char *, const wq_config_t &) {}
	virtual ~ScheduledWorkItem() = default;

	void ScheduleOnInterval(std::uint32_t interval_us) { _interval = interval_us; }
	std::uint32_t interval() const { return _interval; }

	virtual void Run() = 0;

private:
	std::uint32_t _interval{0};
};
}
