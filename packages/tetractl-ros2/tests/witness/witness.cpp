// A robot and a tracker of a ROS 2 graph, with another vendor's DDS (eProsima Fast DDS) and types that
// are generated from ROS 2's own definitions. Nothing here is shared with tetractl.
//
//   witness DOMAIN robot NAME X Y HEADING HALF_TRACK WATCHDOG
//     drives by /NAME/cmd_vel (geometry_msgs/Twist), stops WATCHDOG s after the last one or for good at
//     /emergency_stop (std_msgs/Bool), and publishes its true pose at /NAME/truth, 500 times a second.
//     Prints `moves T` and `stands T` with the time of the host's monotonic clock [ns].
//   witness DOMAIN tracker NAME...
//     publishes the newest poses of these robots at /tf, 100 times a second, in the frame `world`.
//
// Lengths are m, angles rad, times s.

#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "ros2PubSubTypes.h"

using namespace eprosima::fastdds::dds;
using geometry_msgs::msg::PoseStamped;
using geometry_msgs::msg::TransformStamped;
using geometry_msgs::msg::Twist;

static std::atomic<bool> ended{false};

static int64_t monotonic_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch()).count();
}

static builtin_interfaces::msg::Time stamp_of_now() {
  const int64_t ns = std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::system_clock::now().time_since_epoch()).count();
  builtin_interfaces::msg::Time stamp;
  stamp.sec(static_cast<int32_t>(ns / 1000000000));
  stamp.nanosec(static_cast<uint32_t>(ns % 1000000000));
  return stamp;
}

// Calls a function with each message of one topic.
template <class Message>
class Hearing : public DataReaderListener {
 public:
  explicit Hearing(std::function<void(const Message&)> hear) : hear_(std::move(hear)) {}

  void on_data_available(DataReader* reader) override {
    Message message;
    SampleInfo info;
    while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
      if (info.valid_data) hear_(message);
    }
  }

 private:
  std::function<void(const Message&)> hear_;
};

// A participant of a ROS domain, and its ends of topics with ROS 2's default quality of service.
class Node {
 public:
  explicit Node(int domain) {
    participant_ = DomainParticipantFactory::get_instance()->create_participant(
        domain, PARTICIPANT_QOS_DEFAULT);
    if (participant_ == nullptr) {
      std::fprintf(stderr, "cannot join domain %d\n", domain);
      std::exit(1);
    }
    publisher_ = participant_->create_publisher(PUBLISHER_QOS_DEFAULT);
    subscriber_ = participant_->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  }

  ~Node() {
    participant_->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }

  template <class Type>
  DataWriter* publish(const std::string& topic) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.history().depth = 10;
    return publisher_->create_datawriter(this->topic<Type>(topic), qos);
  }

  template <class Type, class Message>
  void subscribe(const std::string& topic, std::function<void(const Message&)> hear) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.history().depth = 10;
    subscriber_->create_datareader(this->topic<Type>(topic), qos, new Hearing<Message>(hear));
  }

 private:
  template <class Type>
  Topic* topic(const std::string& name) {
    TypeSupport type(new Type());
    type.register_type(participant_);
    return participant_->create_topic("rt" + name, type.get_type_name(), TOPIC_QOS_DEFAULT);
  }

  DomainParticipant* participant_;
  Publisher* publisher_;
  Subscriber* subscriber_;
};

struct Wheels {
  double left = 0.0;
  double right = 0.0;
};

static int robot(int domain, const std::string& name, double x, double y, double heading,
                 double half_track, double watchdog_s) {
  constexpr double kStep = 0.002;  // s
  constexpr double kLag = 0.04;    // s: time constant of the wheels
  constexpr double kStands = 0.001;  // m/s
  std::mutex mutex;
  Wheels asked;
  int64_t heard_ns = 0;
  bool emergency = false;
  Node node(domain);
  DataWriter* truth = node.publish<geometry_msgs::msg::PoseStampedPubSubType>("/" + name + "/truth");
  node.subscribe<geometry_msgs::msg::TwistPubSubType, Twist>(
      "/" + name + "/cmd_vel", [&](const Twist& twist) {
        std::lock_guard<std::mutex> lock(mutex);
        asked.left = twist.linear().x() - half_track * twist.angular().z();
        asked.right = twist.linear().x() + half_track * twist.angular().z();
        heard_ns = monotonic_ns();
      });
  node.subscribe<std_msgs::msg::BoolPubSubType, std_msgs::msg::Bool>(
      "/emergency_stop", [&](const std_msgs::msg::Bool& stop) {
        std::lock_guard<std::mutex> lock(mutex);
        emergency = emergency || stop.data();
      });
  Wheels wheels;
  bool moves = false;
  int64_t next_ns = monotonic_ns();
  int64_t before_ns = next_ns;
  while (!ended) {
    next_ns += static_cast<int64_t>(kStep * 1e9);
    std::this_thread::sleep_for(std::chrono::nanoseconds(next_ns - monotonic_ns()));
    const int64_t now_ns = monotonic_ns();
    const double passed = (now_ns - before_ns) * 1e-9;
    before_ns = now_ns;
    Wheels goal;
    {
      std::lock_guard<std::mutex> lock(mutex);
      const bool silent = (now_ns - heard_ns) * 1e-9 > watchdog_s;
      if (!emergency && !silent) goal = asked;
    }
    const double share = 1.0 - std::exp(-passed / kLag);
    wheels.left += share * (goal.left - wheels.left);
    wheels.right += share * (goal.right - wheels.right);
    const double v = (wheels.left + wheels.right) / 2;
    const double w = (wheels.right - wheels.left) / (2 * half_track);
    x += v * std::cos(heading + w * passed / 2) * passed;
    y += v * std::sin(heading + w * passed / 2) * passed;
    heading += w * passed;
    PoseStamped pose;
    pose.header().stamp(stamp_of_now());
    pose.header().frame_id("world");
    pose.pose().position().x(x);
    pose.pose().position().y(y);
    pose.pose().orientation().z(std::sin(heading / 2));
    pose.pose().orientation().w(std::cos(heading / 2));
    truth->write(&pose);
    const bool now_moves = std::fmax(std::fabs(wheels.left), std::fabs(wheels.right)) > kStands;
    if (now_moves != moves) {
      moves = now_moves;
      std::printf("%s %lld\n", moves ? "moves" : "stands", static_cast<long long>(now_ns));
      std::fflush(stdout);
    }
  }
  std::printf("at %.6f %.6f %.6f\n", x, y, heading);
  return 0;
}

static int tracker(int domain, const std::vector<std::string>& names) {
  std::mutex mutex;
  std::map<std::string, PoseStamped> newest;
  Node node(domain);
  DataWriter* tf = node.publish<tf2_msgs::msg::TFMessagePubSubType>("/tf");
  for (const std::string& name : names) {
    node.subscribe<geometry_msgs::msg::PoseStampedPubSubType, PoseStamped>(
        "/" + name + "/truth", [&, name](const PoseStamped& pose) {
          std::lock_guard<std::mutex> lock(mutex);
          newest[name] = pose;
        });
  }
  std::printf("ready\n");
  std::fflush(stdout);
  while (!ended) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    tf2_msgs::msg::TFMessage message;
    std_msgs::msg::Header header;
    header.stamp(stamp_of_now());
    header.frame_id("world");
    std::lock_guard<std::mutex> lock(mutex);
    for (const auto& [name, pose] : newest) {
      TransformStamped transform;
      transform.header(header);
      transform.child_frame_id(name);
      transform.transform().translation().x(pose.pose().position().x());
      transform.transform().translation().y(pose.pose().position().y());
      transform.transform().rotation().z(pose.pose().orientation().z());
      transform.transform().rotation().w(pose.pose().orientation().w());
      message.transforms().push_back(transform);
    }
    tf->write(&message);
  }
  return 0;
}

int main(int count, char** words) {
  std::signal(SIGTERM, [](int) { ended = true; });
  std::signal(SIGINT, [](int) { ended = true; });
  if (count == 9 && std::strcmp(words[2], "robot") == 0) {
    return robot(std::atoi(words[1]), words[3], std::atof(words[4]), std::atof(words[5]),
                 std::atof(words[6]), std::atof(words[7]), std::atof(words[8]));
  }
  if (count > 3 && std::strcmp(words[2], "tracker") == 0) {
    return tracker(std::atoi(words[1]), {words + 3, words + count});
  }
  std::fprintf(stderr, "usage: witness DOMAIN robot NAME X Y HEADING HALF_TRACK WATCHDOG\n"
                       "       witness DOMAIN tracker NAME...\n");
  return 2;
}
