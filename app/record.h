// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields_json.h"

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// A number as results have it: null where it is NaN or infinite, which JSON has no words for.
nlohmann::ordered_json json_number(double v);

/// What a run depended on and what came of it: `run.json`. Given back as `--config run.json`, it
/// repeats the run.
class RunRecord {
 public:
  /// Starts the clock.
  /// command  name of the sub-command
  /// config   the effective configuration, defaults included; see `recorded_config`
  /// seed     of the run
  RunRecord(std::string command, nlohmann::json config, std::uint64_t seed);

  /// Notes size and SHA-256 of a file, or of every file below a folder; of each file once.
  /// throws  IoError
  void add_input(const std::filesystem::path& path);
  /// Notes a reason to look twice at the outcome.
  /// code  for programs
  /// text  in words
  void add_warning(const std::string& code, const std::string& text);
  /// Seconds since the clock was started.
  double seconds() const;
  /// Whatever the command has to say about its outcome.
  nlohmann::json& results() { return results_; }

  /// program, version, git, command, config, seed, host, isa, threads, started (UTC), wall_seconds,
  /// peak_memory_bytes, peak_tensor_bytes, inputs [{path, bytes, sha256}], warnings [{code, text}],
  /// results.
  nlohmann::ordered_json json() const;
  /// Writes `json()`, whole or not at all.
  /// throws  IoError
  void save(const std::filesystem::path& path) const;

 private:
  struct Input {
    std::string path;
    std::uintmax_t bytes = 0;
    std::string sha256;
  };

  std::string command_;
  nlohmann::json config_, results_ = nlohmann::json::object();
  std::uint64_t seed_;
  std::vector<Input> inputs_;
  std::vector<std::pair<std::string, std::string>> warnings_;
  std::chrono::system_clock::time_point started_;
  std::chrono::steady_clock::time_point clock_;
};

/// Names a file or folder from the root of the file system; an empty name stays empty.
std::filesystem::path in_full(const std::filesystem::path& path);
/// Names all files and folders of a configuration so.
void name_in_full(const std::vector<FieldRef>& fields);
/// A configuration as a record has it: whoever repeats the run stands in another folder.
template <HasFields S>
nlohmann::json recorded_config(S config) {
  name_in_full(collect_fields(config));
  return to_json(config);
}

/// The keys of `RunRecord::json` and what they hold, in words.
std::vector<std::pair<std::string, std::string>> record_keys();

/// The configuration in a JSON file: the file itself, or the `config` of a run record.
/// command  that wants it
/// throws   ConfigError, also where there is no such file or where it is another command's record
nlohmann::json load_config(const std::filesystem::path& path, const std::string& command);

/// Whether a folder is what simulate, train or reconstruct left: it holds their run.json.
bool holds_run(const std::filesystem::path& folder);

}  // namespace satsurf::app
