// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>

#include <doctest/doctest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

namespace satsurf::test {

/// A web server of this machine that only counts who comes, and answers nothing.
class QuietServer {
 public:
  QuietServer() : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof at;
    REQUIRE(::bind(socket_, reinterpret_cast<sockaddr*>(&at), size) == 0);
    REQUIRE(::listen(socket_, 8) == 0);
    REQUIRE(::getsockname(socket_, reinterpret_cast<sockaddr*>(&at), &size) == 0);
    url_ = "http://127.0.0.1:" + std::to_string(ntohs(at.sin_port)) + "/a.tif";
    thread_ = std::thread([this] {
      for (int caller; (caller = ::accept(socket_, nullptr, nullptr)) >= 0; ::close(caller))
        ++visits_;
    });
  }
  ~QuietServer() {
    ::shutdown(socket_, SHUT_RDWR);
    thread_.join();
    ::close(socket_);
  }
  QuietServer(const QuietServer&) = delete;
  QuietServer& operator=(const QuietServer&) = delete;

  const std::string& url() const { return url_; }
  int visits() const { return visits_; }

 private:
  int socket_;
  std::string url_;
  std::atomic<int> visits_{0};
  std::thread thread_;
};

}  // namespace satsurf::test
