// SPDX-License-Identifier: Apache-2.0
// What GDAL may reach while it reads for us. A file may name others (the tiles of a DIMAP, the model of
// heights of a VRT, overviews), and each driver opens them in its own way, so that the doors are shut
// here and not driver by driver.
#include "satsurf/rpc/drivers.h"
#include "satsurf/rpc/gdal.h"

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <string>
#include <utility>

#include <cpl_http.h>
#include <cpl_vsi_virtual.h>
#include <sys/stat.h>

namespace satsurf::rpc {
namespace {

/// The first thing that was asked for and refused.
struct Refused {
  std::string file;  ///< which said what it may not, if it was one
  std::string why;   ///< empty if all was well
};
thread_local int scopes = 0;   ///< alive in this thread
thread_local Refused refused;  ///< in them

constexpr const char* kPam = "GDAL_PAM_ENABLED";
/// The one remote file that may be opened.
constexpr const char* kRemote = "CPL_VSIL_CURL_ALLOWED_FILENAME";
constexpr const char* kStdin = "CPL_ALLOW_VSISTDIN";
constexpr const char* kThreads = "GDAL_NUM_THREADS";

/// Stands for GDAL's requests of HTTP and FTP.
CPLHTTPResult* refuse_request(const char* url, CSLConstList, GDALProgressFunc, void*,
                              CPLHTTPFetchWriteFunc, void*, void*) {
  if (refused.why.empty())
    refused = {"", "names " + std::string(url).substr(0, 200) + ", expected files on this machine"};
  const std::string text = std::string(url) + ": nothing is asked of a network";
  CPLError(CE_Failure, CPLE_HttpResponse, "%s", text.c_str());
  auto* result = static_cast<CPLHTTPResult*>(CPLCalloc(1, sizeof(CPLHTTPResult)));
  result->nStatus = 1;  // any of curl's failures
  result->pszErrBuf = CPLStrdup(text.c_str());
  return result;
}

/// Why GDAL may not open a file in a GdalScope, or nothing. Where its claims allow fewer threads than
/// there are, no more will decode it.
std::string refusal_of(const std::string& name, bool to_read) {
  struct stat found {};
  if (::stat(name.c_str(), &found) == 0 && !S_ISREG(found.st_mode) && !S_ISDIR(found.st_mode))
    return "a pipe, socket or device, expected a file";
  if (!to_read) return "";
  const FileClaim claim = claim_of(name);
  if (!claim.refusal.empty() && refused.why.empty()) refused = {name, claim.refusal};
  if (claim.threads) {
    const char* set = CPLGetConfigOption(kThreads, nullptr);
    const Index now = set != nullptr && !EQUAL(set, "ALL_CPUS") ? std::atoi(set) : CPLGetNumCPUs();
    if (*claim.threads < now)
      CPLSetThreadLocalConfigOption(kThreads, std::to_string(*claim.threads).c_str());
  }
  return claim.refusal;
}

/// The file system, less what is no file (a pipe would wait for a writer, a device may never end) and
/// what claims more than it can hold.
class OnlyFiles : public VSIFilesystemHandler {
 public:
  /// all  GDAL's own, which lives on in this
  explicit OnlyFiles(VSIFilesystemHandler* all) : all_(all) {}

  VSIVirtualHandle* Open(const char* name, const char* access, bool set_error,
                         CSLConstList options) override {
    const std::string why = scopes > 0 ? refusal_of(name, access[0] == 'r') : "";
    if (!why.empty()) {
      CPLError(CE_Failure, CPLE_OpenFailed, "%s: %s", name, why.c_str());
      errno = EINVAL;
      return nullptr;
    }
    return all_->Open(name, access, set_error, options);
  }
  int Stat(const char* name, VSIStatBufL* out, int flags) override {
    return all_->Stat(name, out, flags);
  }
  int Unlink(const char* name) override { return all_->Unlink(name); }
  int Mkdir(const char* name, long mode) override { return all_->Mkdir(name, mode); }
  int Rmdir(const char* name) override { return all_->Rmdir(name); }
  char** ReadDirEx(const char* name, int most) override { return all_->ReadDirEx(name, most); }
  char** SiblingFiles(const char* name) override { return all_->SiblingFiles(name); }
  int Rename(const char* from, const char* to) override { return all_->Rename(from, to); }
  int IsCaseSensitive(const char* name) override { return all_->IsCaseSensitive(name); }
  GIntBig GetDiskFreeSpace(const char* name) override { return all_->GetDiskFreeSpace(name); }
  int SupportsSparseFiles(const char* name) override { return all_->SupportsSparseFiles(name); }
  VSIDIR* OpenDir(const char* name, int depth, const char* const* options) override {
    return all_->OpenDir(name, depth, options);
  }

 private:
  std::unique_ptr<VSIFilesystemHandler> all_;
};

/// What holds for the process, once.
void prepare_gdal() {
  static const bool done = [] {
    register_drivers();
    VSIFileManager::InstallHandler("", new OnlyFiles(VSIFileManager::GetHandler("")));
    return true;
  }();
  static_cast<void>(done);
}

}  // namespace

GdalScope::GdalScope() {
  prepare_gdal();
  for (const auto& [name, value] :
       {std::pair{kPam, "NO"}, {kRemote, "none"}, {kStdin, "NO"}, {kThreads, nullptr}}) {
    const char* old = CPLGetThreadLocalConfigOption(name, nullptr);
    before_.emplace_back(name, old ? std::optional<std::string>(old) : std::nullopt);
    if (value != nullptr) CPLSetThreadLocalConfigOption(name, value);
  }
  CPLHTTPPushFetchCallback(refuse_request, nullptr);
  if (scopes++ == 0) refused = {};
  CPLPushErrorHandler(CPLQuietErrorHandler);
  CPLErrorReset();
}

GdalScope::~GdalScope() {
  CPLPopErrorHandler();
  --scopes;
  CPLHTTPPopFetchCallback();
  for (const auto& [name, value] : before_)
    CPLSetThreadLocalConfigOption(name, value ? value->c_str() : nullptr);
}

void check_refused(const std::filesystem::path& path) {
  if (refused.why.empty()) return;
  const Refused what = std::exchange(refused, {});
  const bool itself = what.file.empty() || what.file == path.string();
  throw IoError(path.string() + ": " +
                (itself ? "" : "\"" + what.file.substr(0, 200) + "\", which belongs to it: ") +
                what.why);
}

MemoryFile::MemoryFile(const std::string& ending) {
  static std::atomic<unsigned> count{0};
  name_ = "/vsimem/satsurf_" + std::to_string(count++) + ending;
}

std::optional<std::string_view> MemoryFile::bytes() const {
  vsi_l_offset size = 0;
  const GByte* first = VSIGetMemFileBuffer(name_.c_str(), &size, FALSE);
  if (first == nullptr) return std::nullopt;
  return std::string_view(reinterpret_cast<const char*>(first), static_cast<std::size_t>(size));
}

}  // namespace satsurf::rpc
